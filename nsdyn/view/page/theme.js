// Light or dark, and how large text is: what canvases take from the style sheet.

const theme = {
  dark: false,
  unit: 1,  // pixels of what has one in a window of 1280 x 720
  known: {},
  listeners: [],  // called after a change

  start(picture) {
    const wished = matchMedia("(prefers-color-scheme: dark)");
    wished.addEventListener("change", () => this.set(wished.matches));
    window.addEventListener("resize", () => this.measure());
    this.set(wished.matches && !picture);
  },

  set(dark) {
    this.dark = dark;
    document.documentElement.classList.toggle("dark", dark);
    this.known = {};
    this.measure();
    for (const listener of this.listeners) listener();
  },

  measure() { this.unit = parseFloat(getComputedStyle(document.documentElement).fontSize) / 13; },

  colour(name) {
    return this.known[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  },
};

function px(size) { return size * theme.unit; }

function font(size, weight = "") { return `${weight} ${px(size)}px system-ui, sans-serif`; }

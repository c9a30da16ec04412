// The buttons that all panes obey: which curves, from where the scene is seen, what is drawn over it, help.

const KINDS = {
  energy: "Kinetic and potential energy, and over them what was taken: their sum is what there was",
  power: "What friction, impacts and damping take, mean of each interval",
  motion: "Speeds and heights of bodies, coordinates and loads of joints; a body that is picked stands out",
  checks: "Residual, certificate and penetration of each step",
};
const DRAWN = {
  contacts: "Contact points that stick or slip; those behind bodies are faded",
  open: "Contact points that are open, and carry nothing",
  forces: "Contact forces on bodies, mean since the state before; with two heads those that are cut",
  cones: "Friction cones with the force inside, red at its edge; of redundant contacts those of least norm",
};
const SIGNS = {dark: "◐"};  // of buttons that need no word

class Tools {
  constructor(panes) {
    this.panes = panes;
    this.place = document.getElementById("tools");
    this.kinds = this.group(Object.entries(KINDS), name => this.show(name));
    const toggle = act => (name, button) => {
      const now = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", now);
      for (const pane of panes) act(pane, now, name);
    };
    const toggles = (titles, on, act) => {
      for (const [name, button] of Object.entries(this.group(Object.entries(titles), toggle(act)))) {
        button.setAttribute("aria-pressed", on(name));
      }
    };
    if (panes.length > 1) {
      const title = "The curves of each recording also over those of the other, dotted";
      toggles({overlay: title}, () => false, (pane, now) => pane.lay(now));
    }
    this.group(Object.keys(VIEWS).map(name => [name, `Camera: ${name}`]), name => panes[0].stage.look(name));
    const touching = panes.find(pane => pane.recording.contacts);
    if (touching) toggles(DRAWN, name => touching.overlay.layers[name], (pane, now, name) => pane.draw(name, now));
    if (panes.some(pane => pane.recording.looks.length)) {
      const title = "Collision shapes of robots in place of their visual ones";
      toggles({collision: title}, () => false, (pane, now) => pane.showCollision(now));
    }
    this.makeOthers(toggle((pane, now) => pane.showTree(now)));
    theme.listeners.push(() => this.themed());
    this.makeHelp();
    this.show("energy");
    this.themed();
  }

  // Buttons side by side, by their names: entries [name, title], what a press of one does.
  group(entries, press) {
    const place = this.place.appendChild(element("span"));
    return Object.fromEntries(entries.map(([name, title]) => {
      const button = place.appendChild(element("button", name, SIGNS[name] ?? name[0].toUpperCase() + name.slice(1)));
      if (SIGNS[name]) button.setAttribute("aria-label", name);
      button.title = title;
      button.addEventListener("click", () => press(name, button));
      return [name, button];
    }));
  }

  show(kind) {
    for (const [name, button] of Object.entries(this.kinds)) button.setAttribute("aria-pressed", name === kind);
    for (const pane of this.panes) pane.show(kind);
  }

  themed() {
    this.place.querySelector(".dark").setAttribute("aria-pressed", theme.dark);
    for (const pane of this.panes) pane.show(pane.kind);
  }

  makeOthers(tree) {
    const help = document.getElementById("help");
    const act = {tree, dark: () => theme.set(!theme.dark), "?": () => help.showModal()};
    const titles = {tree: "meshcat's own controls", dark: "Dark or light (d)", "?": "Keys, and how this was made (?)"};
    const buttons = this.group(Object.entries(titles), (name, button) => act[name](name, button));
    buttons.tree.setAttribute("aria-pressed", false);
  }

  // The keys, and how each recording was made and what of it is shown.
  makeHelp() {
    const help = document.getElementById("help");
    for (const {recording: {label, name, made, notes}} of this.panes) {
      help.append(element("h2", "", label.startsWith(name) ? label : `${name}: ${label}`));
      const list = help.appendChild(element("dl"));
      for (const [key, text] of [...Object.entries(made), ...notes.map(note => ["shown", note])]) {
        list.append(element("dt", "", key), element("dd", "", text));
      }
    }
    help.querySelector(".close").addEventListener("click", () => help.close());
    help.addEventListener("click", event => { if (event.target === help) help.close(); });
  }
}

// Numbers as people read them.

const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];
const SUPERSCRIPTS = {"-": "⁻", ..."⁰¹²³⁴⁵⁶⁷⁸⁹"};
const DIGITS = 4;
const NEGLIGIBLE = 1e-9;  // of what is at play: no more than round-off

// "9.81 mJ": with a prefix where the unit takes one and the number is no smaller than that, else with an exponent, as
// "3.788·10⁻⁴ rad"; 0 what is negligible beside `play`.
function withUnit(value, unit, play = 0, digits = DIGITS) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return (value < 0 ? "−∞ " : "∞ ") + unit;
  if (Math.abs(value) <= NEGLIGIBLE * play || value === 0) return `0 ${unit}`.trim();
  const size = Math.abs(value);
  const sign = value < 0 ? "−" : "";
  const scale = PREFIXES.find(([factor]) => size >= factor * (1 - 1e-9));
  const angle = unit.startsWith("rad");
  if (angle || unit === "" || unit === "kg" || unit.startsWith("√")) {
    const number = size >= 1e-3 && size < 1e4 ? trimmed(size, digits) : exponential(size, angle ? digits : 2);
    return sign + number + (unit && " " + unit);
  }
  if (!scale || size >= 1e12) return sign + exponential(size) + " " + unit;
  return sign + trimmed(size / scale[0], digits) + " " + scale[1] + unit;
}

// The same of a round number, without zeros at its end: "5 N".
function plain(value, unit) { return withUnit(value, unit).replace(/(\.\d*?)0+ /, "$1 ").replace(". ", " "); }

function trimmed(size, digits) {
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return size.toFixed(Math.min(decimals, 9));
}

function exponential(size, digits = 2) {
  const [mantissa, power] = size.toExponential(digits - 1).split("e");
  return `${mantissa.replace(/\.0+$/, "")}·${powerOfTen(Number(power))}`;
}

// "10⁻⁷"
function powerOfTen(power) { return "10" + String(power).replace(/./g, digit => SUPERSCRIPTS[digit]); }

// Round steps between two numbers, about so many.
function ticks(low, high, count) {
  const step = roundStep((high - low) / count);
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  return out;
}

// Smallest of 1, 2, 5 times a power of ten that is not below x.
function roundStep(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [1, 2, 5, 10].find(k => k * power >= x * (1 - 1e-9));
}

// A number on an axis whose steps are known.
function onAxis(value, step) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return (value < 0 ? "−" : "") + exponential(size);
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−");
}

// An element with a class and text; names from recordings only ever become text.
function element(tag, className, text) {
  const out = document.createElement(tag);
  if (className) out.className = className;
  if (text !== undefined) out.textContent = text;
  return out;
}

// The size of a canvas in the pixels of the screen, and a context that draws in those of the page.
function contextOf(canvas) {
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

// A line through points [x, y].
function drawLine(context, points, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
}

// What the plot under a view shows: where the energy is and who took it, power, and what vouches for the steps.

const CHECKS = [
  {name: "residual", label: "residual", unit: "m/s", colour: "#3b75af", words: "of the contact problem"},
  {name: "bound", label: "certificate", unit: "√J", colour: "#b5405e", words: "bound of the velocity's error"},
  {name: "penetration", label: "penetration", unit: "m", colour: "#5aa17f", words: "of shapes, by their gaps"},
];
const took = ({name, sign}) => sign < 0 && name !== "drives";  // and puts nothing in
const FLOOR = 1e-12, LOST = 1e-11;  // where their axes begin at the lowest, and what is no more than round-off

class Ledger {
  constructor(recording) {
    this.recording = recording;
    this.curve = name => recording.arrays[`ledger/${name}`];
    this.t = this.curve("t");
    const most = name => this.curve(name).reduce((size, x) => Math.max(size, Math.abs(x)), 0);
    const least = NEGLIGIBLE * recording.largest;
    this.layers = recording.layers.filter(({name, sign}) => sign > 0 || most(name) > least);
    this.fed = most("put_in") > least;
  }

  // Heights of the stack.
  stack() { return stacked(this.t, this.layers.map(({name, sign}) => this.curve(name).map(x => sign * x))); }

  // Where the top of the stack ought to be: what there was, and what was put in.
  expected() {
    const start = this.curve("kinetic")[0] + this.curve("potential")[0];
    return this.curve("put_in").map(x => start + x);
  }

  // What a chart shows of a kind of curves: the ledgers `beside` have the same scale, and the curves of those that are
  // `laid` over this one are drawn too.
  lanes(kind, beside, laid) {
    return {t: this.t, steps: kind !== "energy", lanes: this[kind](beside, laid)};
  }

  energy(beside, laid) {
    const heights = this.stack();
    const lane = {unit: "energy [J]", ...this.range("extremes", beside, laid)};
    lane.areas = this.layers.map(({colour}, k) => ({values: [heights[k], heights[k + 1]], colour}));
    lane.lines = [
      {values: heights[heights.length - 1], colour: theme.colour("ink"), width: 1.5},
      {values: this.expected(), colour: theme.colour("ink"), dash: [5, 4], width: 1},
    ];
    for (const other of laid) {
      other.stack().slice(1).forEach((values, k) => lane.lines.push(dotted(other.t, values, other.layers[k].colour)));
    }
    if (this.recording.at_rest) lane.note = `at rest: nothing of ${withUnit(this.recording.largest, "J")} moves`;
    return [lane];
  }

  // Least and largest value of the stack; round-off of what is at rest does not fill its axis.
  extremes() {
    if (this.recording.at_rest) {
      const least = 1e-6 * this.recording.largest || 1;
      return [-0.1 * least, 0.9 * least];
    }
    return spanOf([...this.stack(), this.expected()]);
  }

  // Mean power since the point before that each work took.
  powers() {
    const rate = values => values.map((x, k) => k ? (x - values[k - 1]) / (this.t[k] - this.t[k - 1]) : NaN);
    return this.layers.filter(took).map(layer => ({...layer, values: rate(this.curve(layer.name)).map(x => -x)}));
  }

  // Heights of their stack.
  powerStack() { return stacked(this.t, this.powers().map(({values}) => values)); }

  power(beside, laid) {
    const powers = this.powers();
    const heights = this.powerStack();
    const lane = {unit: "power [W]", ...this.range("powerExtremes", beside, laid)};
    lane.areas = powers.map(({colour}, k) => ({values: [heights[k], heights[k + 1]], colour}));
    if (!powers.length) {
      const words = this.recording.layers.filter(took).map(({label}) => label.replace(" took", ""));
      lane.note = `${words.slice(0, -1).join(", ")} and ${words[words.length - 1]} take nothing`;
    }
    lane.lines = laid.flatMap(other => (
      other.powers().map(({colour}, k) => dotted(other.t, other.powerStack()[k + 1], colour))));
    const top = heights[heights.length - 1].reduce((a, b) => b > a ? b : a, 0);
    if (top > lane.high) lane.remark = `peaks up to ${withUnit(top, "W")} are cut`;
    return [lane];
  }

  // Peaks of impacts, which a short step makes arbitrarily high, do not hide the rest.
  powerExtremes() {
    const powers = this.powers();
    const sums = Array.from(this.t, (_, k) => powers.reduce((sum, {values}) => sum + values[k], 0)).slice(1);
    if (!powers.length || !sums.length) return [0, 1];
    const sorted = sums.filter(x => x > 0).sort((a, b) => a - b);
    const [most, usual] = [sorted[sorted.length - 1] ?? 1, sorted[Math.floor(0.9 * sorted.length)] ?? 1];
    return [Math.min(0, ...sums), Math.min(most, 5 * usual)];
  }

  range(extremes, beside, laid) {
    const [low, high] = commonRange([this, ...beside].map(ledger => ledger[extremes]()), laid.length);
    const room = 0.06 * (high - low || 1);
    return {low: low < 0 ? low - room : low, high: high + room};
  }

  checks(beside, laid) {
    return CHECKS.map(({name, unit, colour}) => {
      const values = this.curve(name);
      const positive = [this, ...laid].flatMap(ledger => Array.from(ledger.curve(name))).filter(x => x > 0 && Number.isFinite(x));
      const [least, most] = spanOf([positive]);
      const recorded = values.some(x => !Number.isNaN(x));
      const seen = most > LOST;
      const low = seen ? 10 ** Math.floor(Math.log10(Math.max(least, 1e-8 * most, FLOOR))) : LOST;
      const high = seen ? Math.max(10 * low, 10 ** Math.ceil(Math.log10(most) + 1e-9)) : 10 * LOST;
      const note = !recorded ? "not recorded" : seen ? "" : `less than ${powerOfTen(Math.round(Math.log10(LOST)))}: round-off`;
      const lines = [{values, colour, width: 2}, ...laid.map(other => dotted(other.t, other.curve(name), colour))];
      return {unit, log: true, low, high, note, lines};
    });
  }

  // [label, colour, value, unit, what is at play, words for the pointer] at a time, for each kind of plot.
  values(kind, t) {
    const at = name => this.recording.at(name, t);
    if (kind === "checks") {
      const {next} = this.after(t);
      return CHECKS.map(({name, label, unit, colour, words}) => [label, colour, this.curve(name)[next], unit, 0, words]);
    }
    if (kind === "power") {
      const {next} = this.after(t);
      const play = this.recording.largest / (this.t[this.t.length - 1] - this.t[0] || 1);
      return this.powers().map(({label, colour, values}) => [label.replace(" took", ""), colour, values[next], "W", play]);
    }
    const {largest} = this.recording;
    const rows = this.layers.map(({name, label, colour, sign}) => [label, colour, sign * at(name), "J", largest]);
    const total = rows.reduce((sum, row) => sum + row[2], 0);
    const numerics = this.recording.numerics.reduce((sum, name) => sum + at(name), 0);
    if (this.fed) rows.push(["put in", theme.colour("faint"), at("put_in"), "J", largest]);
    return [...rows, ["sum", theme.colour("ink"), total, "J", largest], ["by numerics", "", numerics, "J", largest]];
  }

  // The point of the curves that ends the interval a time is in.
  after(t) {
    const place = Recording.place(this.t, t);
    return {next: place.part > 0 ? place.next : place.at};
  }
}

// Heights of a stack of curves: its foot and what each of them reaches.
function stacked(t, curves) {
  const heights = [t.map(() => 0)];
  for (const values of curves) heights.push(heights.at(-1).map((x, k) => x + values[k]));
  return heights;
}

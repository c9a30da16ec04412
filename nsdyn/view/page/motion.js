// The plot of motion: how fast bodies are and how high, and of joints where they are and what drives them.

const SINGLED = 10;  // most curves that have a value each beside the plot

class Motion {
  constructor(recording, inspector) {
    Object.assign(this, {recording, inspector});
    const {bodies, free, t, arrays} = recording;
    this.t = t;
    this.lanesOf = new Map();
    bodies.forEach((body, number) => {
      const {name, colour, frame} = body;
      const add = (unit, values) => {
        if (!values.some(Number.isFinite)) return;
        if (!this.lanesOf.has(unit)) this.lanesOf.set(unit, []);
        this.lanesOf.get(unit).push({number, name: body.joint?.name ?? name, colour, values});
      };
      if (frame >= 0 && frame < free) {
        add("speed [m/s]", Float32Array.from(t, (_, k) => arrays["bodies/speed"][k * free + frame]));
        if (!bodies.some(({joint}) => joint)) add("height [m]", recording.heights(frame));
      }
      for (const {label, unit, values} of recording.joint(body)) {
        if (["angle", "position", "torque", "force"].includes(label)) add(`${label} [${unit}]`, values);
      }
    });
    // Joints that nothing drives have no loads to show.
    for (const [unit, curves] of this.lanesOf) {
      if (curves.every(({values}) => values.every(x => !x))) this.lanesOf.delete(unit);
    }
  }

  // Number of the body that is picked, or null.
  get picked() { return this.inspector.picked?.body ?? null; }

  lanes() {
    const lanes = Array.from(this.lanesOf, ([unit, curves]) => {
      const known = curves.flatMap(({values}) => Array.from(values).filter(Number.isFinite));
      const [low, high] = [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))];
      const least = 1e-6 * Math.max(Math.abs(low), Math.abs(high), 1e-3);  // round-off does not fill the axis
      const room = Math.max(0.06 * (high - low), least);
      const lines = curves.map(({number, colour, values}) => {
        const faded = this.picked !== null && this.picked !== number;
        return {values, colour: colour + (faded ? "48" : ""), width: this.picked === number ? 2.4 : 1.4};
      });
      return {unit, low: low < 0 || low > room ? low - room : low, high: high + room, lines};
    });
    const note = "nothing moves";
    return {t: this.t, steps: false, lanes: lanes.length ? lanes : [{unit: "", low: 0, high: 1, note}]};
  }

  // [label, colour, value, unit, what is at play] at a time, of the body that is picked, or of all where they are few.
  values(_, t) {
    const {at, part, next} = Recording.place(this.t, t);
    const rows = [];
    const all = Array.from(this.lanesOf.values()).reduce((sum, curves) => sum + curves.length, 0);
    for (const [unit, curves] of this.lanesOf) {
      const most = curves[0].values.reduce((size, x) => Number.isFinite(x) ? Math.max(size, Math.abs(x)) : size, 0);
      for (const {number, name, colour, values} of curves) {
        if (this.picked !== null ? number !== this.picked : all > SINGLED) continue;
        const value = part > 0 ? values[at] + part * (values[next] - values[at]) : values[at];
        rows.push([`${name} ${unit.split(" ")[0]}`, colour, value, unit.match(/\[(.*)\]/)[1], most]);
      }
    }
    return rows;
  }
}

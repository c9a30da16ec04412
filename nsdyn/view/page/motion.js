// The plot of motion: how fast bodies are and how high, and of joints where they are and what drives them.

const SINGLED = 10;  // most curves that have a value each beside the plot
const SHOWN = 12, NAMED = 6;  // most of which all have names, and how many have of more, one in each colour of the palette

const STILL_HERE = 1e-4;  // of where it is, what moves less does not

class Motion {
  constructor(recording, inspector) {
    Object.assign(this, {recording, inspector});
    const {bodies, t} = recording;
    this.t = t;
    this.lanesOf = new Map();
    this.first = new Map();  // number of the first body that each one's joint carries, whose curves it has
    bodies.forEach((body, number) => {
      const {name, colour, frame, joint} = body;
      const first = joint ? bodies.findIndex(other => other.joint?.name === joint.name) : number;
      this.first.set(number, first);
      if (first !== number) return;
      const add = (unit, values) => {
        if (!values.some(Number.isFinite)) return;
        if (!this.lanesOf.has(unit)) this.lanesOf.set(unit, []);
        this.lanesOf.get(unit).push({number, name: joint?.name ?? name, colour, values});
      };
      if (frame >= 0 && !joint && body.mass !== null) {
        add("speed [m/s]", recording.column("bodies/speed", frame));
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
    this.named = this.singledOut();
  }

  // Numbers of bodies whose curves have names and colours: all, of many those that move most, in as many colours.
  singledOut() {
    const sizes = new Map();
    for (const curves of this.lanesOf.values()) {
      const spans = curves.map(({values}) => spanOf([values]));
      const most = Math.max(...spans.map(([low, high]) => high - low)) || 1;
      curves.forEach(({number}, k) => {
        sizes.set(number, Math.max(sizes.get(number) ?? 0, (spans[k][1] - spans[k][0]) / most));
      });
    }
    const order = Array.from(sizes.keys()).sort((a, b) => sizes.get(b) - sizes.get(a));
    if (order.length <= SHOWN) return new Set(order);
    const hue = number => this.recording.bodies[number].frame % NAMED;
    const first = order.filter((number, k) => order.findIndex(other => hue(other) === hue(number)) === k);
    return new Set([...first, ...order].filter((number, k, all) => all.indexOf(number) === k).slice(0, NAMED));
  }

  // Number of the body whose curves are those of the one that is picked, or null.
  get picked() { return this.first.get(this.inspector.picked?.body) ?? null; }

  // What a chart shows: `beside` and `laid` are as for the ledger.
  lanes(kind, beside, laid) {
    const lanes = Array.from(this.lanesOf, ([unit, curves]) => {
      const all = [curves, ...beside.map(other => other.lanesOf.get(unit) ?? [])].filter(curves => curves.length);
      let [low, high] = commonRange(all.map(curves => spanOf(curves.map(({values}) => values))), laid.length);
      // Round-off, of 15 bits, does not fill the axis: what stays where it is is shown beside 0.
      if (high - low < STILL_HERE * Math.max(Math.abs(low), Math.abs(high))) [low, high] = [Math.min(0, low), Math.max(0, high)];
      const room = Math.max(0.06 * (high - low), 1e-9);
      const lines = [...this.lines(curves, high - low), ...laid.flatMap(other => other.over(unit))];
      return {unit, low: low < 0 || low > room ? low - room : low, high: high + room, lines};
    });
    const note = "nothing moves";
    return {t: this.t, steps: false, lanes: lanes.length ? lanes : [{unit: "", low: 0, high: 1, note}]};
  }

  // Lines of curves, those with names, which take turns where they are the same, and the one that is picked in front.
  lines(curves, range) {
    const front = number => this.picked === number ? 2 : this.named.has(number) ? 1 : 0;
    const sorted = [...curves].sort((a, b) => front(a.number) - front(b.number));
    const lines = sorted.map(({number, colour, values}) => {
      const own = front(number) ? colour : theme.colour("light");
      const faded = this.picked !== null && this.picked !== number;
      return {values, colour: own + (faded ? "48" : ""), width: [1, 1.6, 2.6][front(number)]};
    });
    if (this.picked === null) takingTurns(lines.filter((_, k) => front(sorted[k].number)), range);
    return lines;
  }

  // Those with names, over the curves of another recording.
  over(unit) {
    const curves = (this.lanesOf.get(unit) ?? []).filter(({number}) => this.named.has(number));
    return curves.map(({values, colour}) => dotted(this.t, values, colour));
  }

  // [label, colour, value, unit, what is at play] at a time: all of the body that is picked, or of all where they are few,
  // else the first of each that has a name.
  values(_, t) {
    const {at, part, next} = Recording.place(this.t, t);
    const all = Array.from(this.lanesOf.values()).reduce((sum, curves) => sum + curves.length, 0);
    const each = this.picked !== null || all <= SINGLED;
    const [rows, seen] = [[], new Set()];
    for (const [unit, curves] of this.lanesOf) {
      const span = spanOf(curves.map(({values}) => values)).map(Math.abs);
      const most = Math.max(...span, unit.startsWith("speed") ? this.recording.play.speed : 0);
      for (const {number, name, colour, values} of curves) {
        if (this.picked !== null && number !== this.picked) continue;
        if (!each && (seen.has(number) || !this.named.has(number))) continue;
        seen.add(number);
        const value = part > 0 ? values[at] + part * (values[next] - values[at]) : values[at];
        const label = each ? `${name} ${unit.split(" ")[0]}` : name;
        rows.push([label, colour, value, unit.match(/\[(.*)\]/)[1], most]);
      }
    }
    const others = new Set(Array.from(this.lanesOf.values()).flat().map(({number}) => number)).size - seen.size;
    return each || !others ? rows : [...rows, [`and ${others} others`, theme.colour("light")]];
  }
}

// Least and largest finite number of some arrays.
function spanOf(arrays) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of arrays) {
    for (const x of values) {
      if (x < low && x > -Infinity) low = x;
      if (x > high && x < Infinity) high = x;
    }
  }
  return low <= high ? [low, high] : [0, 0];
}

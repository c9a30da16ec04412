// What Python packed: values and arrays, and what of them belongs to a time.

const TYPES = {f4: Float32Array, f8: Float64Array, u1: Uint8Array, u4: Uint32Array};
const STATES = ["open", "stick", "slip", "jam"];
const AT_EDGE = 4;

class Recording {
  // Read the text of `nsdyn.recording.bundle.pack`.
  static async unpack(text) {
    const letters = atob(text.trim());
    const packed = new Uint8Array(letters.length);
    for (let k = 0; k < packed.length; k++) packed[k] = letters.charCodeAt(k);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const data = await new Response(stream).arrayBuffer();
    const length = Number(new DataView(data).getBigUint64(0, true));
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length)));
    const arrays = {};
    for (const [name, {type, at, size}] of Object.entries(head.arrays)) {
      arrays[name] = Recording.unshuffled(new Uint8Array(data, 8 + length + at), TYPES[type], size);
    }
    return new Recording(head.values, arrays);
  }

  // Bytes of equal weight stand together in the text.
  static unshuffled(planes, Type, size) {
    const out = new Type(size);
    const bytes = new Uint8Array(out.buffer);
    const width = Type.BYTES_PER_ELEMENT;
    for (let b = 0; b < width; b++) {
      for (let k = 0, from = b * size, to = b; k < size; k++, to += width) bytes[to] = planes[from + k];
    }
    return out;
  }

  constructor(values, arrays) {
    Object.assign(this, values);
    this.arrays = arrays;
    this.t = arrays.t;
    // What is at play: beside it round-off is nothing.
    const fastest = (arrays["bodies/speed"] ?? []).reduce((a, b) => b > a ? b : a, 0);
    const gravity = Math.hypot(...this.gravity);
    const masses = new Map(this.bodies.map(({frame, mass}) => [frame, mass]));  // of each frame once
    const weight = gravity * Array.from(masses.values()).reduce((sum, mass) => sum + mass, 0);
    this.play = {speed: Math.max(fastest, this.dt * gravity), force: Math.max(weight, this.units?.cones ?? 0)};
  }

  // When there were impacts, and words for the pointer.
  get impacts() {
    const a = this.arrays;
    return Array.from(a["impacts/t"], (t, k) => {
      const names = [0, 1].map(side => this.bodies[this.geoms[a["impacts/geoms"][2 * k + side]].body].name);
      const [speed, impulse] = [withUnit(a["impacts/speed"][k], "m/s"), withUnit(a["impacts/impulse"][k], "N·s")];
      return {t, text: `impact at ${t.toPrecision(5)} s: ${names.join(" – ")}, ${speed}, ${impulse}`};
    });
  }

  // Number of the last of ascending times that is not after t, and how far t is on the way to the next.
  static place(times, t) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= t + 1e-9 * Math.max(1, Math.abs(t))) low = middle; else high = middle - 1;
    }
    const next = Math.min(low + 1, times.length - 1);
    const length = times[next] - times[low];
    return {at: low, part: length > 0 ? Math.min(1, Math.max(0, (t - times[low]) / length)) : 0, next};
  }

  frame(t) { return Recording.place(this.t, t).at; }

  // Commands for meshcat's viewer.
  *commands() {
    let start = 0;
    for (const end of this.arrays.command_ends) {
      yield this.arrays.commands.subarray(start, end);
      start = end;
    }
  }

  // Clips for meshcat's animator, of the frames that change their place or direction; all share the times.
  animations() {
    const clips = new Map();
    const times = Float32Array.from(this.t, t => t - this.begin);
    const duration = times[times.length - 1];
    for (const [name, which, type, width] of [
      ["position", "moving", "vector3", 3], ["quaternion", "turning", "quaternion", 4],
    ]) {
      const size = width * times.length;
      this.arrays[`motion/${which}`].forEach((frame, k) => {
        const values = this.arrays[`motion/${name}`].subarray(k * size, (k + 1) * size);
        if (!clips.has(frame)) clips.set(frame, {fps: 1, name: "default", duration, tracks: []});
        clips.get(frame).tracks.push({name: `.${name}`, type, times, values});
      });
    }
    return Array.from(clips, ([frame, clip]) => ({path: pathOf(this.frames[frame]), clip}));
  }

  // Places of a moving frame over time [{t, x}]; one if it never moves.
  path(frame, start) {
    const k = this.arrays["motion/moving"].indexOf(frame);
    if (k < 0) return [{t: this.begin, x: start}];
    const values = this.arrays["motion/position"];
    return Array.from(this.t, (t, row) => {
      const at = 3 * (k * this.t.length + row);
      return {t, x: Array.from(values.subarray(at, at + 3))};
    });
  }

  // Values of one frame in all states.
  column(name, frame) {
    return Float32Array.from(this.t, (_, k) => this.arrays[name][k * this.frames.length + frame]);
  }

  // Heights in all states of a frame, none of one that never moves.
  heights(frame) { return this.path(frame).filter(({x}) => x).map(({x}) => x[2]); }

  // Value of a curve of the ledger at a time, between its points.
  at(name, t) {
    const {at, part, next} = Recording.place(this.arrays["ledger/t"], t);
    const values = this.arrays[`ledger/${name}`];
    return values[at] + part * (values[next] - values[at]);
  }

  // Rows of the contacts of a time: those of the step that ends at the state shown before it.
  contactRows(t) {
    if (!this.contacts) return {rows: [], at: 0};
    const place = Recording.place(this.arrays["contacts/t"], t);
    const [first, last] = this.arrays["contacts/offset"].subarray(place.at, place.at + 2);
    return {first, last, ...place};
  }

  // One contact by its row.
  contact(row) {
    const a = this.arrays;
    const three = name => a[`contacts/${name}`].subarray(3 * row, 3 * row + 3);
    const id = a["contacts/id"][row];
    const state = a["contacts/state"][row];
    const [first, second] = [0, 1].map(k => this.geoms[a["contacts/geoms"][2 * id + k]].body);
    return {
      row, id, first, second, state: state % AT_EDGE, edge: state >= AT_EDGE,
      point: three("point"), normal: three("normal"), r: three("r"), mu: a["contacts/mu"][id],
      u_N: a["contacts/u_N"][row], u_T: a["contacts/u_T"][row],
      gap: a["contacts/gap"][row], taken: a["contacts/taken"][row],
    };
  }

  // Contacts of a time; their points move on to where they are in the next state that has them too.
  contactsAt(t) {
    const {first, last, at, part, next} = this.contactRows(t);
    const out = [];
    if (first === undefined) return out;
    const ids = this.arrays["contacts/id"];
    const points = this.arrays["contacts/point"];
    const offset = this.arrays["contacts/offset"];
    let other = offset[next];
    for (let row = first; row < last; row++) {
      const contact = this.contact(row);
      if (next > at && part > 0) {
        while (other < offset[next + 1] && ids[other] < contact.id) other++;
        if (other < offset[next + 1] && ids[other] === contact.id) {
          contact.point = contact.point.map((x, k) => x + part * (points[3 * other + k] - x));
        }
      }
      out.push(contact);
    }
    return out;
  }

  // World vector of (N, T1, T2) at a contact: axes as `nsdyn.recording.contact_points.axes`.
  world(contact, [N, T1, T2]) {
    const n = contact.normal;
    let t1 = Math.abs(n[2]) < 0.9 ? [-n[1], n[0], 0] : [0, -n[2], n[1]];
    const size = Math.hypot(...t1);
    t1 = t1.map(x => x / size);
    const t2 = cross(n, t1);
    return [0, 1, 2].map(k => N * n[k] + T1 * t1[k] + T2 * t2[k]);
  }

  // Contacts a body takes part in, and on which side: +1 where the impulse acts on it, -1 where its opposite does.
  *contactsOf(body, rows) {
    const a = this.arrays;
    const [ids, geoms] = [a["contacts/id"], a["contacts/geoms"]];
    for (let row = rows.first; row < rows.last; row++) {
      const on2 = this.geoms[geoms[2 * ids[row] + 1]].body === body;
      const on1 = this.geoms[geoms[2 * ids[row]]].body === body;
      if (on1 !== on2) yield {row, sign: on2 ? 1 : -1};
    }
  }

  // Net contact force on a body in the step before a time, N, and how many contacts carry something.
  force(body, t) {
    const sum = [0, 0, 0];
    let carrying = 0;
    const rows = this.contactRows(t);
    if (rows.first === undefined) return null;
    for (const {row, sign} of this.contactsOf(body, rows)) {
      const contact = this.contact(row);
      this.world(contact, contact.r).forEach((x, k) => { sum[k] += sign * x / this.dt; });
      if (contact.r[0] > 0) carrying++;
    }
    return {sum, carrying};
  }

  // Of the joint that carries a body, values at states, NaN where there is none, as of steps at the first; which are
  // drawn over time.
  joint({joint}) {
    if (!joint) return [];
    const [unit, load] = joint.units;
    const count = this.arrays["joints/force"].length / this.t.length;
    return [
      [unit === "rad" ? "angle" : "position", "position", unit, true], ["velocity", "velocity", `${unit}/s`, false],
      [load === "N" ? "force" : "torque", "torque", load, true],
      ["reaction", "force", "N", true], ["its moment", "moment", "N·m", false],
    ].map(([label, name, unit, drawn]) => {
      const values = Float32Array.from(this.t, (_, k) => this.arrays[`joints/${name}`][k * count + joint.column]);
      const play = {N: this.play.force, "N·m": this.play.force * this.view.radius}[unit] ?? 0;
      return {label, unit, drawn, values, play};
    }).filter(({values}) => values.some(Number.isFinite));
  }

  // Sums over the contacts of a body of r_N and |r_T| over a step, N, in those that end at states; none at the first.
  loads(body) {
    const states = this.arrays["contacts/t"];
    const first = Math.min(1, states.length - 1);
    const times = states.subarray(first);
    const [normal, drag] = [new Float32Array(times.length), new Float32Array(times.length)];
    const offset = this.arrays["contacts/offset"];
    const r = this.arrays["contacts/r"];
    for (let k = 0; k < times.length; k++) {
      for (const {row} of this.contactsOf(body, {first: offset[first + k], last: offset[first + k + 1]})) {
        normal[k] += r[3 * row] / this.dt;
        drag[k] += Math.hypot(r[3 * row + 1], r[3 * row + 2]) / this.dt;
      }
    }
    return {times, normal, drag};
  }
}

// Path of a node in meshcat's tree.
function pathOf(text) { return text.split("/").filter(Boolean); }

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

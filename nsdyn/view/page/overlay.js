// What is drawn over the 3D picture: contacts, friction cones, forces, the trail of a body. Seen through bodies, for
// contacts are between them.

const STATE_COLOURS = ["#ffffff", "#0072b2", "#e69f00", "#c8102e"];  // open, stick, slip, jam: told apart by shape too
const FORCE_COLOUR = "#30363d";
const EDGE_COLOUR = "#c8102e";
const LONGEST = 2;  // times what 90 % stay below: arrows of impacts, beside which the others would be dots, are cut there
const HIDDEN = [0.22, 0.5];  // of a dot behind a body is seen: the less, the more there are

class Overlay {
  constructor(canvas, stage, recording) {
    Object.assign(this, {canvas, stage, recording, t: recording.begin, contacts: [], placed: []});
    // The contact picked by its identity, the body picked {frame, name}, and where it has been [{t, x}].
    this.selected = this.marked = this.trail = null;
    const forces = recording.forces;
    const picture = document.body.classList.contains("picture");  // shows bodies alone unless asked for more
    this.layers = {contacts: forces || !picture || document.body.classList.contains("curved"), open: false, cones: false, forces};
    stage.drawn.push(() => this.draw());
  }

  seek(t) {
    this.t = t;
    this.contacts = this.recording.contactsAt(t);
  }

  // How many contacts are in each state.
  get counts() {
    const out = [0, 0, 0, 0];
    for (const {state} of this.contacts) out[state]++;
    return out;
  }

  // Of "forces" and "cones", whether any is longer than it is drawn.
  get cut() {
    const {arrays, dt, units} = this.recording;
    const most = (values, width) => {
      let most = 0;
      for (let k = 0; k < values?.length; k += width) most = Math.max(most, Math.hypot(...values.subarray(k, k + width)));
      return most;
    };
    const [force, push] = [most(arrays["forces/force"], 3), most(arrays["contacts/r"]?.filter((_, k) => k % 3 === 0), 1) / dt];
    return {forces: force > LONGEST * units?.forces, cones: push > LONGEST * units?.cones};
  }

  // Metres that a newton is long, of "forces" or "cones".
  scale(layer) {
    const {units, lengths} = this.recording;
    return units?.[layer] ? lengths[layer] / units[layer] : 0;
  }

  draw() {
    const context = contextOf(this.canvas);
    if (this.trail) this.drawTrail(context);
    if (this.layers.cones) for (const contact of this.contacts) this.drawCone(context, contact);
    if (this.layers.forces) this.drawForces(context);
    this.placed = [];
    if (this.layers.contacts) this.drawContacts(context);
    if (this.marked) this.drawMark(context);
  }

  drawContacts(context) {
    const {stage} = this;
    stage.sight.look(stage.camera);
    // No larger than leaves the bodies to be seen, if these are many.
    const size = Math.min(px(4.2), Math.max(px(3), 0.13 * stage.sight.usual * stage.pixelsPerMetre));
    for (const contact of this.contacts) {
      if (contact.state === 0 && !this.layers.open) continue;
      const at = stage.project(contact.point);
      if (at) this.placed.push({contact, at, hidden: stage.sight.hides(contact.point)});
    }
    // Those behind bodies first, faded.
    const faded = Math.max(HIDDEN[0], Math.min(HIDDEN[1], 12 / this.placed.length));
    for (const {contact, at, hidden} of this.placed.sort((a, b) => b.hidden - a.hidden)) {
      const selected = contact.id === this.selected;
      context.globalAlpha = hidden && !selected ? faded : 1;
      drawDot(context, at[0], at[1], contact.state, selected ? px(7) : size * (hidden ? 0.8 : 1));
      if (selected) ring(context, at, px(11));
    }
    context.globalAlpha = 1;
  }

  // The contact nearest to a pixel, within a few.
  pick(x, y) {
    let best = {distance: px(8), contact: null};
    for (const {contact, at} of this.placed) {
      const distance = Math.hypot(at[0] - x, at[1] - y);
      if (distance < best.distance) best = {distance, contact};
    }
    return best.contact;
  }

  // Impulses act on body 2; shown is what acts on a moving body, as the forces do.
  side(contact) { return this.recording.bodies[contact.second].frame >= 0 ? 1 : -1; }

  drawCone(context, contact) {
    const {recording, stage} = this;
    const normal = contact.r[0] / recording.dt;
    if (!(normal > 0)) return;
    const full = normal * this.scale("cones");
    const height = Math.min(LONGEST * recording.lengths.cones, full);
    const metres = this.side(contact) * height / contact.r[0];  // of an impulse of 1 N·s
    const tip = impulse => stage.project(recording.world(contact, impulse).map((x, k) => contact.point[k] + metres * x));
    const apex = stage.project(contact.point);
    const rim = [];
    for (let k = 0; k < 24; k++) {
      const turn = 2 * Math.PI * k / 24;
      const radius = contact.mu * contact.r[0];
      rim.push(tip([contact.r[0], radius * Math.cos(turn), radius * Math.sin(turn)]));
    }
    if (!apex || rim.some(point => !point)) return;
    const colour = contact.edge ? EDGE_COLOUR : theme.dark ? "#9db4d0" : "#4b6584";
    context.fillStyle = colour + "12";
    context.strokeStyle = colour + "a0";
    context.lineWidth = 1;
    for (let k = 0; k < 24; k++) context.fill(polygonOf([apex, rim[k], rim[(k + 1) % 24]]));
    context.stroke(polygonOf(rim));
    for (const k of silhouette(apex, rim)) context.stroke(polygonOf([apex, rim[k]]));
    const end = tip(contact.r);
    if (end) arrow(context, apex, end, contact.edge ? EDGE_COLOUR : FORCE_COLOUR, height < full);
  }

  drawForces(context) {
    const {recording, stage} = this;
    const a = recording.arrays;
    const {at} = recording.contactRows(this.t);
    for (let k = a["forces/offset"][at]; k < a["forces/offset"][at + 1]; k++) {
      const frame = a["forces/frame"][k];
      const world = name => stage.turned(frame, Array.from(a[`forces/${name}`].subarray(3 * k, 3 * k + 3)));
      const origin = stage.origin(frame);
      const from = world("point").map((x, c) => x + origin[c]);
      const force = world("force");
      const full = this.scale("forces");
      const scale = Math.min(full, LONGEST * recording.lengths.forces / Math.hypot(...force));
      const to = from.map((x, c) => x + scale * force[c]);
      const ends = [stage.project(from), stage.project(to)];
      if (ends[0] && ends[1]) arrow(context, ...ends, FORCE_COLOUR, scale < full);
    }
  }

  // The name of the body that is picked, with a line to its origin.
  drawMark(context) {
    const at = this.stage.project(this.stage.origin(this.marked.frame));
    if (!at) return;
    context.font = font(12, "600");
    context.textAlign = "left";
    const [x, y] = [at[0] + px(26), at[1] - px(26)];
    const width = context.measureText(this.marked.name).width;
    drawLine(context, [at, [x, y]], "#111111", px(1.5));
    context.fillStyle = "#111111";
    context.beginPath();
    context.arc(at[0], at[1], px(3), 0, 2 * Math.PI);
    context.fill();
    context.beginPath();
    context.roundRect(x - px(5), y - px(14), width + px(10), px(19), px(4));
    context.fill();
    context.fillStyle = "white";
    context.fillText(this.marked.name, x, y);
  }

  drawTrail(context) {
    const points = this.trail.filter(point => point.t <= this.t).map(point => this.stage.project(point.x)).filter(Boolean);
    drawLine(context, points, theme.colour("trail"), px(2));
  }
}

// A disc where a contact sticks, a diamond where it slips, an empty ring where it is open.
function drawDot(context, x, y, state, size) {
  context.beginPath();
  if (state === 2) {
    const half = 1.25 * size;
    context.moveTo(x - half, y);
    for (const [dx, dy] of [[0, -half], [half, 0], [0, half]]) context.lineTo(x + dx, y + dy);
    context.closePath();
  } else {
    context.arc(x, y, state === 0 ? 0.8 * size : size, 0, 2 * Math.PI);
  }
  context.fillStyle = STATE_COLOURS[state];
  context.fill();
  context.lineWidth = Math.min(1.2, 0.3 * size);
  context.strokeStyle = state === 0 ? "#56616d" : "white";
  context.stroke();
}

function ring(context, [x, y], size) {
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  context.lineWidth = px(2);
  context.strokeStyle = "#111111";
  context.stroke();
}

function polygonOf(points) {
  const path = new Path2D();
  for (const [x, y] of points) path.lineTo(x, y);
  path.closePath();
  return path;
}

// The two points of the rim of a cone between which and its apex its outline runs; none where it is seen from inside.
function silhouette(apex, rim) {
  const side = (a, b) => (a[0] - apex[0]) * (b[1] - apex[1]) - (a[1] - apex[1]) * (b[0] - apex[0]);
  const turns = rim.map((point, k) => Math.sign(side(point, rim[(k + 1) % rim.length])));
  return rim.map((_, k) => k).filter(k => turns[k] * turns[(k + rim.length - 1) % rim.length] < 0);
}

// An arrow; with two heads if it is shorter than it ought to be.
function arrow(context, from, to, colour, cut) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(dx, dy);
  if (length < 1) return;
  const head = Math.min(px(10), (cut ? 0.3 : 0.6) * length);
  const [ux, uy] = [dx / length, dy / length];
  const back = by => [to[0] - by * ux, to[1] - by * uy];
  const tips = (cut ? [0, head] : [0]).map(by => {
    const [point, [x, y]] = [back(by), back(by + head)];
    return polygonOf([point, [x - 0.45 * head * uy, y + 0.45 * head * ux], [x + 0.45 * head * uy, y - 0.45 * head * ux]]);
  });
  const shaft = new Path2D();
  shaft.moveTo(from[0], from[1]);
  shaft.lineTo(...back(head));
  // With a white rim, to be seen on dark bodies.
  context.strokeStyle = "white";
  for (const [path, width] of [[shaft, 5.5], ...tips.map(tip => [tip, 3])]) {
    context.lineWidth = px(width);
    context.stroke(path);
  }
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = px(2.4);
  context.stroke(shaft);
  for (const tip of tips) context.fill(tip);
}

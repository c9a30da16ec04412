// What is known of the body or the contact that was picked.

const PLOT_POINTS = 2000;

class Inspector {
  constructor(place, recording, stage, overlay) {
    Object.assign(this, {place, recording, stage, overlay, picked: null, plots: [], changed: () => {}});
  }

  clear() {
    this.picked = null;
    this.overlay.selected = this.overlay.trail = this.overlay.marked = null;
    this.stage.follow(null);
    this.place.classList.remove("shown");
    this.place.replaceChildren();
    this.stage.viewer.set_dirty();
    this.changed();
  }

  // Panel with a title and a table whose rows are filled at each time.
  open(title, rows) {
    this.clear();
    this.place.classList.add("shown");
    this.place.append(element("h2", "", title));
    const close = this.place.appendChild(element("button", "close", "✕"));
    close.title = "Close";
    close.addEventListener("click", () => this.clear());
    const table = this.place.appendChild(element("table"));
    this.cells = {};
    for (const label of rows) {
      const row = table.insertRow();
      row.append(element("th", "", label));
      this.cells[label] = row.insertCell();
    }
    this.plots = [];
  }

  body(number) {
    const {recording} = this;
    const body = recording.bodies[number];
    const moving = body.frame >= 0;
    const rows = body.mass !== null ? ["mass", "speed", "kinetic energy", "potential energy"] : [];
    if (recording.contacts) rows.push("contact force", "carried by");
    const joint = recording.joint(body);
    if (joint.length) rows.push("joint", ...joint.map(({label}) => label));
    this.open(body.name, rows);
    this.joint = joint;
    if (joint.length) this.set("joint", body.joint.name);
    this.picked = {body: number};
    if (!moving) this.place.append(element("p", "", "It is fixed."));
    else if (body.mass === null) this.place.append(element("p", "", "Its mass and speed are not recorded."));
    else if (body.joint) this.place.querySelector("h2").append(element("small", "", " mass, speed, energies: of all that its joint carries"));
    if (moving) {
      this.overlay.marked = {frame: body.frame, name: body.name};
      this.buttons(body.frame);
      this.curves(number, body);
    }
    this.seek(this.overlay.t);
    this.changed();
  }

  buttons(frame) {
    const row = this.place.appendChild(element("div", "row"));
    const add = (text, title, turn) => {
      const button = row.appendChild(element("button", text.toLowerCase(), text));
      button.title = title;
      button.setAttribute("aria-pressed", "false");
      button.addEventListener("click", () => {
        const on = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", on);
        turn(on);
        this.stage.viewer.set_dirty();
      });
    };
    add("Follow", "The camera goes with the body", on => this.stage.follow(on ? frame : null));
    add("Trail", "Where it has been", on => { this.overlay.trail = on ? this.recording.path(frame, this.stage.origin(frame)) : null; });
  }

  // Another pane may have taken the camera along.
  showFollowed() {
    this.place.querySelector(".follow")?.setAttribute("aria-pressed", this.stage.followed !== null);
  }

  curves(number, body) {
    const {recording} = this;
    const path = recording.path(body.frame, this.stage.origin(body.frame));
    const last = path[path.length - 1];
    if (last.t < recording.end) path.push({t: recording.end, x: last.x});
    this.plot("height", "m", path.map(point => point.t), path.map(point => point.x[2]));
    if (body.mass !== null) this.plot("speed", "m/s", recording.t, recording.column("bodies/speed", body.frame));
    for (const {label, unit, values, play} of this.joint.filter(({drawn}) => drawn)) {
      const known = Array.from(values.keys()).filter(k => Number.isFinite(values[k]));
      this.plot(label, unit, known.map(k => recording.t[k]), known.map(k => values[k]), play);
    }
    if (!recording.contacts) return;
    const {times, normal, drag} = recording.loads(number);
    const most = normal.reduce((a, b) => Math.max(a, b), 0);
    this.plot("normal", "N", times, normal, most);
    this.plot("friction", "N", times, drag, most);
  }

  // A curve over time, of which what is round-off beside `play` is no motion.
  plot(label, unit, times, values, play = 0) {
    const stride = Math.ceil(times.length / PLOT_POINTS);
    const keep = array => Array.from(array).filter((_, k) => k % stride === 0);
    const canvas = this.place.appendChild(element("canvas", "plot"));
    canvas.dataset.label = label;
    this.plots.push({canvas, label, unit, play, times: keep(times), values: keep(values)});
  }

  contact(contact) {
    const {recording} = this;
    const names = [contact.first, contact.second].map(body => recording.bodies[body].name);
    this.open(names.join(" → "), Object.keys(this.figures(contact)));
    this.picked = {contact: contact.id};
    this.overlay.selected = contact.id;
    this.seek(this.overlay.t);
  }

  seek(t) {
    if (!this.picked) return;
    const {contact: id, body} = this.picked;
    if (id !== undefined) this.showContact(this.overlay.contacts.find(contact => contact.id === id));
    else this.showBody(body, t);
    for (const plot of this.plots) this.drawPlot(plot, t);
  }

  set(label, text) {
    if (this.cells[label]) this.cells[label].textContent = text;
  }

  showBody(number, t) {
    const {recording, stage} = this;
    const {frame, mass, centre} = recording.bodies[number];
    if (mass !== null) {
      const at = recording.frame(t) * recording.frames.length + frame;
      const {largest, play} = recording;
      this.set("speed", withUnit(recording.arrays["bodies/speed"][at], "m/s", play.speed));
      this.set("kinetic energy", withUnit(recording.arrays["bodies/kinetic"][at], "J", largest));
      const [origin, lever] = [stage.origin(frame), stage.turned(frame, centre)];
      const potential = -mass * recording.gravity.reduce((sum, g, k) => sum + g * (origin[k] + lever[k]), 0);
      this.set("potential energy", withUnit(potential, "J", largest));
      this.set("mass", plain(mass, "kg"));
    }
    for (const {label, unit, values, play} of this.joint) this.set(label, withUnit(values[recording.frame(t)], unit, play));
    const force = recording.force(number, t);
    if (!force) return;
    const {play} = recording;
    this.set("contact force", withUnit(Math.hypot(...force.sum), "N", play.force));
    this.cells["contact force"].title = force.sum.map(x => withUnit(x, "N", play.force)).join(", ");
    this.set("carried by", `${force.carrying} contact${force.carrying === 1 ? "" : "s"}`);
  }

  showContact(contact) {
    const told = contact ? this.figures(contact) : {state: "apart"};
    for (const label of Object.keys(this.cells)) this.set(label, told[label] ?? "–");
  }

  // What is told of a contact, by the names of rows.
  figures(contact) {
    const {dt, play, largest, view: {radius}} = this.recording;
    const [N, T] = [contact.r[0], Math.hypot(contact.r[1], contact.r[2])];
    return {
      state: STATES[contact.state] + (contact.edge ? ", at the edge" : ""),
      gap: withUnit(contact.gap, "m", radius),
      "normal force": withUnit(N / dt, "N", play.force),
      friction: withUnit(T / dt, "N", play.force),
      "friction / (μ normal)": contact.mu * N > 0 ? (T / (contact.mu * N)).toFixed(3) : "–",
      μ: withUnit(contact.mu, ""),
      u_N: withUnit(contact.u_N, "m/s", play.speed),
      "|u_T|": withUnit(contact.u_T, "m/s", play.speed),
      r_N: withUnit(N, "N·s", play.force * dt),
      "|r_T|": withUnit(T, "N·s", play.force * dt),
      dissipated: withUnit(contact.taken, "J", largest),
    };
  }

  drawPlot({canvas, label, unit, play, times, values}, t) {
    const context = contextOf(canvas);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const {begin, end} = this.recording;
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const flat = high - low <= 1e-6 * Math.max(Math.abs(low), Math.abs(high), play);
    const x = time => 1 + (width - 2) * (time - begin) / (end - begin || 1);
    const y = value => flat ? 0.6 * height : height - px(3) - (height - px(18)) * (value - low) / (high - low);
    context.fillStyle = theme.colour("back");
    context.fillRect(0, 0, width, height);
    drawLine(context, times.map((time, k) => [x(time), y(values[k])]), theme.colour("curve"), px(1.3));
    drawLine(context, [[x(t), 0], [x(t), height]], theme.colour("accent"), 1);
    context.font = font(10.5);
    context.textAlign = "left";
    context.fillStyle = theme.colour("ink");
    context.fillText(label, px(4), px(11));
    context.textAlign = "right";
    context.fillStyle = theme.colour("faint");
    const size = Math.max(play, Math.abs(low), Math.abs(high));
    const [least, most] = [low, high].map(value => withUnit(value, unit, size, 3));
    const range = flat ? most : `${least.replace(/^0 .*/, "0")}…${most}`;
    context.fillText(range, width - px(4), px(11));
  }
}

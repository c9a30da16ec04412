// One recording on the page: its view, what is drawn over it, and its curves.

class Pane {
  constructor(recording, clock) {
    Object.assign(this, {recording, clock, kind: "energy", laid: false, others: []});
    this.root = document.getElementById("panes").appendChild(element("section", "pane"));
    const head = this.root.appendChild(element("div", "head"));
    const heading = head.appendChild(element("div", "heading", recording.label));
    const {label, name, words} = recording;
    heading.append(element("small", "", [label.startsWith(name) ? "" : name, words].filter(Boolean).join(", ")));
    this.legend = head.appendChild(element("div", "legend"));
    const view = this.root.appendChild(element("div", "view"));
    const three = view.appendChild(element("div", "three"));
    this.stage = stageFor(three.appendChild(element("div", "three")), recording);
    this.overlay = new Overlay(view.appendChild(element("canvas")), this.stage, recording);
    const below = this.root.appendChild(element("div", "below")).appendChild(element("div", "parts"));
    const aside = below.appendChild(element("aside", "sheet")).appendChild(element("div", "inspector"));
    this.inspector = new Inspector(aside, recording, this.stage, this.overlay);
    below.appendChild(element("aside", "sheet")).append(this.stage.viewer.gui.domElement);
    this.stage.viewer.gui.domElement.classList.add("gui");
    this.makeLegend();
    this.makeCurves(below.appendChild(element("div", "curves")));
    this.timeline = new Timeline(below.appendChild(element("canvas", "scrubber")), clock, recording.impacts);
    this.stage.drawn.push(() => this.scaleBars(), () => this.inspector.showFollowed());
    this.pickOn(three);
    new ResizeObserver(() => this.stage.resize()).observe(view);
    new ResizeObserver(() => this.chart.redraw()).observe(this.chart.place);
    new ResizeObserver(() => this.timeline.draw()).observe(this.timeline.canvas);
  }

  // Whether contacts, forces or cones are drawn.
  draw(layer, on) {
    this.overlay.layers[layer] = on;
    this.showLegend();
    this.stage.viewer.set_dirty();
  }

  // Whether collision shapes are drawn in place of the visual ones of robots.
  showCollision(on) { this.stage.showCollision(on); }

  // Whether meshcat's own controls are open.
  showTree(on) {
    const {gui} = this.stage.viewer;
    gui.domElement.classList.toggle("shown", on);
    if (on) gui.open(); else gui.close();
  }

  makeLegend() {
    const offset = this.recording.arrays["contacts/offset"] ?? [];
    const most = offset.reduce((most, end, k) => Math.max(most, end - (offset[k - 1] ?? end)), 0);
    this.counts = [1, 2, 0].map(state => {
      const entry = this.legend.appendChild(element("span", STATES[state]));
      const sample = entry.appendChild(element("canvas"));
      sample.width = sample.height = 14;
      drawDot(sample.getContext("2d"), 7, 7, state, 4.2);
      const number = entry.appendChild(element("span"));
      number.style.display = "inline-block";
      number.style.minWidth = `${`${most} ${STATES[state]}`.length}ch`;  // whatever it is, the view keeps its size
      return {state, number};
    });
    const {cut} = this.overlay;
    this.bars = ["forces", "cones"].map(layer => {
      const entry = this.legend.appendChild(element("span", `scale ${layer}`, layer + " "));
      return {layer, entry, bar: entry.appendChild(element("span", "bar")), text: entry.appendChild(element("span")), more: cut[layer] ? ", ↠ stronger" : ""};
    });
    this.showLegend();
  }

  showLegend() {
    const {contacts, open, forces, cones} = this.overlay.layers;
    const any = this.recording.contacts;
    this.legend.style.display = any && (contacts || forces || cones) ? "" : "none";
    for (const {state, number} of this.counts) {
      number.parentElement.style.display = contacts && (state > 0 || open) ? "" : "none";
    }
    for (const {layer, entry} of this.bars) {
      entry.style.display = this.overlay.layers[layer] && this.overlay.scale(layer) ? "" : "none";
    }
  }

  // Round forces, and how long they are in the middle of the picture.
  scaleBars() {
    for (const {layer, bar, text, more} of this.bars) {
      const pixels = this.overlay.scale(layer) * this.stage.pixelsPerMetre;
      if (!pixels) continue;
      const force = roundStep(24 / pixels);
      bar.style.width = `${force * pixels}px`;
      text.textContent = plain(force, "N") + more;
    }
  }

  makeCurves(curves) {
    this.ledger = new Ledger(this.recording);
    this.motion = new Motion(this.recording, this.inspector);
    this.inspector.changed = () => { if (this.kind === "motion") this.show(this.kind); };
    this.figures = curves.appendChild(element("div", "values"));
    this.chart = new Chart(curves.appendChild(element("div", "plot")), t => {
      this.clock.pause();
      this.clock.seek(t);
    });
  }

  // Whether the curves of the recordings beside are drawn over these.
  lay(on) {
    this.laid = on;
    this.show(this.kind);
  }

  show(kind) {
    this.kind = kind;
    const plot = kind === "motion" ? "motion" : "ledger";
    const others = this.others.map(pane => pane[plot]);
    this.plot = this[plot];
    const lanes = this.plot.lanes(kind, others, this.laid ? others : []);
    document.body.style.setProperty("--lanes", lanes.lanes.length);
    this.chart.show({begin: this.clock.begin, end: this.clock.end, ...lanes});
    this.figures.replaceChildren();
    const entry = (label, className, colour, words = "") => {
      const place = this.figures.appendChild(element("span"));
      place.title = words;
      place.appendChild(element("i", className)).style[className ? "color" : "background"] = colour;
      place.append(label + " ");
      return place;
    };
    if (this.laid) {
      entry(this.recording.label, "stroke", theme.colour("ink"));
      for (const {recording} of this.others) entry(recording.label, "stroke other", theme.colour("ink"));
    }
    this.cells = this.plot.values(kind, this.clock.t).map(([label, colour, , unit, , words]) => (
      entry(label, "", colour, words).appendChild(element(unit === undefined ? "span" : "b"))));
    for (const {remark} of lanes.lanes) if (remark) this.figures.appendChild(element("small", "", remark));
    this.seek(this.clock.t);
  }

  seek(t) {
    const time = Math.min(this.recording.end, Math.max(this.recording.begin, t));
    this.stage.seek(time);
    this.overlay.seek(time);
    const counts = this.overlay.counts;
    for (const {state, number} of this.counts) number.textContent = `${counts[state]} ${STATES[state]}`;
    this.chart.cursor(t);
    this.timeline.draw();
    this.plot.values(this.kind, time).forEach(([, , value, unit, play], k) => {
      if (unit !== undefined) this.cells[k].textContent = withUnit(value, unit, play);
    });
    this.inspector.seek(time);
  }

  // A click that is no drag picks a contact, or the body behind it.
  pickOn(three) {
    let start = null;
    three.addEventListener("pointerdown", event => { start = [event.clientX, event.clientY]; });
    three.addEventListener("pointerup", event => {
      if (!start || Math.hypot(event.clientX - start[0], event.clientY - start[1]) > 4) return;
      const box = three.getBoundingClientRect();
      this.pick(event.clientX - box.left, event.clientY - box.top);
    });
  }

  pick(x, y) {
    const contact = this.overlay.pick(x, y);
    const body = contact ? null : this.stage.pick(x, y);
    if (contact) this.inspector.contact(contact);
    else if (body === null) this.inspector.clear();
    else this.inspector.body(body);
    this.stage.viewer.set_dirty();
  }
}

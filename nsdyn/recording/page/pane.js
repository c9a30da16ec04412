// One recording on the page: its view, what is drawn over it, and its curves.

class Pane {
  constructor(recording, clock) {
    Object.assign(this, {recording, clock, kind: "energy"});
    this.root = document.getElementById("panes").appendChild(element("section", "pane"));
    const view = this.root.appendChild(element("div", "view"));
    const three = view.appendChild(element("div", "three"));
    this.stage = new Stage(three.appendChild(element("div", "three")), recording);
    this.overlay = new Overlay(view.appendChild(element("canvas")), this.stage, recording);
    this.stage.viewer.gui.domElement.classList.add("gui");
    const heading = element("div", "heading", recording.name);
    heading.append(element("small", "", `h = ${plain(recording.dt, "s")}${recording.solver && ", " + recording.solver}`));
    view.append(this.stage.viewer.gui.domElement, heading);
    this.tools = view.appendChild(element("div", "tools"));
    this.legend = view.appendChild(element("div", "legend"));
    this.inspector = new Inspector(view.appendChild(element("aside", "inspector")), recording, this.stage, this.overlay);
    this.makeTools();
    this.makeLegend();
    this.makeCurves();
    this.stage.drawn.push(() => this.scaleBars());
    this.pickOn(three);
    new ResizeObserver(() => this.stage.resize()).observe(view);
    new ResizeObserver(() => this.chart.redraw()).observe(this.chart.place);
  }

  makeTools() {
    const group = () => this.tools.appendChild(element("span"));
    const add = (place, id, text, title, action) => {
      const button = place.appendChild(element("button", id, text));
      button.title = title;
      button.addEventListener("click", () => action(button));
      return button;
    };
    const views = group();
    for (const name of Object.keys(VIEWS)) {
      add(views, name, name[0].toUpperCase() + name.slice(1), `Camera: ${name}`, () => this.stage.look(name));
    }
    const layers = group();
    const titles = {
      contacts: "Contact points: stick, slip, open",
      forces: "Contact forces on bodies, mean since the state before",
      cones: "Friction cones with the force inside, red at its edge; of redundant contacts forces are not unique",
    };
    for (const [name, title] of Object.entries(titles)) {
      if (!this.recording.contacts) break;
      const button = add(layers, name, name[0].toUpperCase() + name.slice(1), title, () => {
        this.overlay.layers[name] = !this.overlay.layers[name];
        button.setAttribute("aria-pressed", this.overlay.layers[name]);
        this.showLegend();
        this.stage.viewer.set_dirty();
      });
      button.setAttribute("aria-pressed", this.overlay.layers[name]);
    }
    add(group(), "tree", "Tree", "meshcat's own controls", button => {
      button.setAttribute("aria-pressed", this.stage.viewer.gui.domElement.classList.toggle("shown"));
    });
  }

  makeLegend() {
    this.counts = [1, 2, 0].map(state => {
      const entry = this.legend.appendChild(element("span", STATES[state]));
      const sample = entry.appendChild(element("canvas"));
      sample.width = sample.height = 14;
      drawDot(sample.getContext("2d"), 7, 7, state, 4.2);
      return {state, number: entry.appendChild(element("span"))};
    });
    this.bars = ["forces", "cones"].map(layer => {
      const entry = this.legend.appendChild(element("span", `scale ${layer}`, layer + " "));
      return {layer, entry, bar: entry.appendChild(element("span", "bar")), text: entry.appendChild(element("span"))};
    });
    this.showLegend();
  }

  showLegend() {
    const {contacts, forces, cones} = this.overlay.layers;
    const any = this.recording.contacts;
    this.legend.style.display = any && (contacts || forces || cones) ? "" : "none";
    for (const {number} of this.counts) number.parentElement.style.display = contacts ? "" : "none";
    for (const {layer, entry} of this.bars) {
      entry.style.display = this.overlay.layers[layer] && this.overlay.scale(layer) ? "" : "none";
    }
  }

  // Round forces, and how long they are in the middle of the picture.
  scaleBars() {
    for (const {layer, bar, text} of this.bars) {
      const pixels = this.overlay.scale(layer) * this.stage.pixelsPerMetre;
      if (!pixels) continue;
      const force = roundStep(40 / pixels);
      bar.style.width = `${force * pixels}px`;
      text.textContent = plain(force, "N");
    }
  }

  makeCurves() {
    const {recording} = this;
    this.ledger = new Ledger(recording);
    this.ranges = {};
    const curves = this.root.appendChild(element("div", "curves"));
    const header = curves.appendChild(element("header"));
    const tabs = header.appendChild(element("nav"));
    this.tabs = {};
    for (const [kind, text, title] of [
      ["energy", "Energy", "Kinetic and potential energy, and over them what was taken: their sum is what there was"],
      ["power", "Power", "What friction, impacts and damping take, mean of each interval"],
      ["checks", "Checks", "Residual, certificate and overlap of each step"],
    ]) {
      const button = this.tabs[kind] = tabs.appendChild(element("button", kind, text));
      button.title = title;
      button.addEventListener("click", () => this.show(kind));
    }
    this.figures = header.appendChild(element("div", "values"));
    this.chart = new Chart(curves.appendChild(element("div", "plot")), t => {
      this.clock.pause();
      this.clock.seek(t);
    });
  }

  show(kind) {
    this.kind = kind;
    for (const [name, button] of Object.entries(this.tabs)) button.setAttribute("aria-selected", name === kind);
    this.chart.show({begin: this.clock.begin, end: this.clock.end, ...this.ledger[kind](this.ranges[kind])});
    this.figures.replaceChildren();
    this.cells = this.ledger.values(kind, this.clock.t).map(([label, colour]) => {
      const entry = this.figures.appendChild(element("span"));
      const sample = entry.appendChild(element("i"));
      sample.style.background = colour;
      entry.append(label + " ");
      return entry.appendChild(element("b"));
    });
    this.seek(this.clock.t);
  }

  seek(t) {
    const time = Math.min(this.recording.end, Math.max(this.recording.begin, t));
    this.stage.seek(time);
    this.overlay.seek(time);
    const counts = this.overlay.counts;
    for (const {state, number} of this.counts) number.textContent = `${counts[state]} ${STATES[state]}`;
    this.chart.cursor(t);
    this.ledger.values(this.kind, time).forEach(([, , value, unit], k) => {
      this.cells[k].textContent = withUnit(value, unit);
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
    const shape = contact ? null : this.stage.pick(x, y);
    if (contact) this.inspector.contact(contact);
    else if (shape === null) this.inspector.clear();
    else this.inspector.body(this.recording.geoms[shape].body);
    this.stage.viewer.set_dirty();
  }
}

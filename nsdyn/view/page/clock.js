// The time that all recordings of the page show, and the dock that changes it.

const PLAY = "M2 0v14l11-7z";
const PAUSE = "M2 0h4v14H2zM8 0h4v14H8z";

class Clock {
  // `dt` is the step that the clock can tell.
  constructor(begin, end, dt) {
    const decimals = Math.min(9, Math.max(2, Math.ceil(-Math.log10(dt))));
    Object.assign(this, {begin, end, decimals, t: begin, speed: 1, playing: false, listeners: [], last: 0});
  }

  // "0.25 s of 1 s"
  get told() {
    return `${this.t.toFixed(this.decimals)} s of ${this.end.toPrecision(3).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "")} s`;
  }

  seek(t) {
    this.t = Math.min(this.end, Math.max(this.begin, t));
    for (const listener of this.listeners) listener(this.t);
  }

  play() {
    if (this.playing) return;
    if (this.t >= this.end) this.t = this.begin;
    this.playing = true;
    this.last = performance.now();
    requestAnimationFrame(now => this.tick(now));
    this.seek(this.t);
  }

  pause() {
    this.playing = false;
    this.seek(this.t);
  }

  tick(now) {
    if (!this.playing) return;
    const passed = Math.max(0, now - this.last) / 1000;
    this.last = now;
    if (this.t + this.speed * passed >= this.end) this.playing = false;
    this.seek(this.t + this.speed * passed);
    requestAnimationFrame(later => this.tick(later));
  }
}

class Dock {
  // `states` are the times of all states shown, `impacts` {t, text} of all that are marked.
  constructor(clock, states, impacts) {
    Object.assign(this, {clock, states, impacts});
    const on = (id, action) => document.getElementById(id).addEventListener("click", action);
    on("play", () => this.toggle());
    on("first", () => clock.seek(clock.begin));
    on("last", () => clock.seek(clock.end));
    on("back", event => this.step(-1, event.shiftKey));
    on("forward", event => this.step(1, event.shiftKey));
    this.slider = document.querySelector("#speed input");
    this.slider.addEventListener("input", () => {
      this.setSpeed(Math.abs(this.slider.value) < 0.06 ? 1 : 10 ** this.slider.value);  // 1 is easy to find
    });
    this.setSpeed(1);
    document.addEventListener("keydown", event => this.key(event));
    // What is pressed with the pointer does not take the focus, and with it the space bar.
    document.addEventListener("mousedown", event => { if (event.target.closest("button")) event.preventDefault(); });
    clock.listeners.push(() => this.draw());
  }

  toggle() {
    if (this.clock.playing) this.clock.pause(); else this.clock.play();
  }

  setSpeed(speed) {
    this.clock.speed = Math.min(2, Math.max(0.001, speed));
    document.querySelector("#speed output").textContent = `${Number(this.clock.speed.toPrecision(2))} ×`;
  }

  key(event) {
    const help = document.getElementById("help");
    const focused = document.activeElement;
    if (event.ctrlKey || event.altKey || event.metaKey || (help.open && event.key !== "?")) return;
    if (event.key === " " ? focused.matches("button") : focused.type === "range" && event.key !== "?") return;
    const action = {
      " ": () => this.toggle(),
      "?": () => { if (help.open) help.close(); else help.showModal(); },
      d: () => theme.set(!theme.dark),
      ArrowLeft: () => this.step(-1, event.shiftKey),
      ArrowRight: () => this.step(1, event.shiftKey),
      Home: () => this.clock.seek(this.clock.begin),
      End: () => this.clock.seek(this.clock.end),
    }[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  // To the next state, or impact, in a direction.
  step(direction, impacts) {
    const times = impacts ? this.impacts.map(impact => impact.t) : this.states;
    const now = this.clock.t;
    const least = 1e-9 * Math.max(1, Math.abs(now));
    const found = direction > 0 ? times.find(t => t > now + least) : times.findLast(t => t < now - least);
    this.clock.pause();
    if (found !== undefined) this.clock.seek(found);
  }

  draw() {
    const {clock} = this;
    document.querySelector("#play path").setAttribute("d", clock.playing ? PAUSE : PLAY);
    const face = document.getElementById("clock");
    const [shown, end] = clock.told.split(" of ");
    face.textContent = shown;
    face.append(element("small", "", ` / ${end.replace(" s", "")}`));
  }
}

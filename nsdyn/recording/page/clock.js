// The time that all recordings of the page show, and the dock that changes it.

const PLAY = "M2 0v14l11-7z";
const PAUSE = "M2 0h4v14H2zM8 0h4v14H8z";

class Clock {
  constructor(begin, end) {
    Object.assign(this, {begin, end, t: begin, speed: 1, playing: false, listeners: [], last: 0});
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
  // `states` are the times of all states shown, `impacts` {t, text} of what is marked, `dt` the step the clock can tell.
  constructor(clock, states, impacts, dt) {
    Object.assign(this, {clock, states, impacts, decimals: Math.min(9, Math.max(2, Math.ceil(-Math.log10(dt))))});
    this.scrubber = document.getElementById("scrubber");
    const on = (id, action) => document.getElementById(id).addEventListener("click", action);
    on("play", () => this.toggle());
    on("first", () => clock.seek(clock.begin));
    on("last", () => clock.seek(clock.end));
    on("back", event => this.step(-1, event.shiftKey));
    on("forward", event => this.step(1, event.shiftKey));
    const slider = document.querySelector("#speed input");
    slider.addEventListener("input", () => {
      this.setSpeed(Math.abs(slider.value) < 0.04 ? 1 : 10 ** slider.value);  // 1 is easy to find
    });
    this.setSpeed(1);
    this.scrubber.addEventListener("pointerdown", event => {
      this.scrubber.setPointerCapture(event.pointerId);
      clock.pause();
      clock.seek(this.snapped(event.offsetX));
    });
    this.scrubber.addEventListener("pointermove", event => {
      if (event.buttons) clock.seek(this.timeAt(event.offsetX));
      else this.hint(event.offsetX);
    });
    const bounds = {min: clock.begin, max: clock.end};
    for (const [name, t] of Object.entries(bounds)) this.scrubber.setAttribute(`aria-value${name}`, t);
    document.addEventListener("keydown", event => this.key(event));
    // What is pressed with the pointer does not take the focus, and with it the space bar.
    document.addEventListener("mousedown", event => { if (event.target.closest("button")) event.preventDefault(); });
    clock.listeners.push(() => this.draw());
  }

  toggle() {
    if (this.clock.playing) this.clock.pause(); else this.clock.play();
  }

  setSpeed(speed) {
    this.clock.speed = Math.min(2, Math.max(0.1, speed));
    document.querySelector("#speed output").textContent = this.clock.speed.toFixed(2) + " ×";
  }

  key(event) {
    const help = document.getElementById("help");
    const focused = document.activeElement;
    if (event.ctrlKey || event.altKey || event.metaKey || (help.open && event.key !== "?")) return;
    if (event.key === " " ? focused.matches("button") : focused.type === "range" && event.key !== "?") return;
    const action = {
      " ": () => this.toggle(),
      "?": () => { if (help.open) help.close(); else help.showModal(); },
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

  x(t) {
    const {begin, end} = this.clock;
    return 8 + (this.scrubber.clientWidth - 16) * (t - begin) / (end - begin || 1);
  }

  timeAt(x) {
    const {begin, end} = this.clock;
    return begin + (end - begin) * (x - 8) / (this.scrubber.clientWidth - 16);
  }

  // The impact whose mark is under the pointer.
  marked(x) {
    const near = this.impacts.filter(impact => Math.abs(this.x(impact.t) - x) <= 4);
    return near.sort((a, b) => Math.abs(this.x(a.t) - x) - Math.abs(this.x(b.t) - x))[0];
  }

  snapped(x) { return this.marked(x)?.t ?? this.timeAt(x); }

  hint(x) { this.scrubber.title = this.marked(x)?.text ?? ""; }

  draw() {
    const {clock, scrubber} = this;
    const context = contextOf(scrubber);
    const [left, right, now] = [this.x(clock.begin), this.x(clock.end), this.x(clock.t)];
    context.fillStyle = "#d5dbe1";
    context.fillRect(left, 15, right - left, 6);
    context.fillStyle = "#0b5ea8";
    context.fillRect(left, 15, now - left, 6);
    context.fillStyle = "#c2410c";
    for (const {t} of this.impacts) context.fillRect(this.x(t) - 0.75, 4, 1.5, 11);
    context.fillStyle = "#6b7785";
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "center";
    if (clock.end > clock.begin) {
      const times = ticks(clock.begin, clock.end, Math.max(2, (right - left) / 90));
      for (const t of times) {
        context.fillRect(this.x(t), 21, 1, 4);
        context.fillText(onAxis(t, times[1] - times[0] || 1), Math.min(right - 8, Math.max(left + 4, this.x(t))), 34);
      }
    }
    context.beginPath();
    context.arc(now, 18, 7, 0, 2 * Math.PI);
    context.fillStyle = "#0b5ea8";
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = "white";
    context.stroke();
    document.querySelector("#play path").setAttribute("d", clock.playing ? PAUSE : PLAY);
    const face = document.getElementById("clock");
    const [shown, end] = [`${clock.t.toFixed(this.decimals)} s`, clock.end.toPrecision(3).replace(/\.?0+$/, "")];
    face.textContent = shown;
    face.append(element("small", "", ` / ${end}`));
    scrubber.setAttribute("aria-valuenow", clock.t);
    scrubber.setAttribute("aria-valuetext", `${shown} of ${end} s`);
  }
}

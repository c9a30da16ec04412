// The scrubber of a pane: time on the axis of its curves, with a mark at every impact.

const EDGES = {left: 58, right: 14};  // from which to which the axis of time goes

// Pixels of a time on an axis of a width, and back.
function timeX(t, {begin, end}, width) {
  return px(EDGES.left) + (width - px(EDGES.left + EDGES.right)) * (t - begin) / (end - begin || 1);
}

function timeAtX(x, {begin, end}, width) {
  return begin + (end - begin) * (x - px(EDGES.left)) / (width - px(EDGES.left + EDGES.right));
}

class Timeline {
  // `impacts` are {t, text} of what is marked.
  constructor(canvas, clock, impacts) {
    Object.assign(this, {canvas, clock, impacts});
    canvas.tabIndex = 0;
    const told = {role: "slider", "aria-label": "time", "aria-valuemin": clock.begin, "aria-valuemax": clock.end};
    for (const [name, value] of Object.entries(told)) canvas.setAttribute(name, value);
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      clock.pause();
      clock.seek(this.marked(event.offsetX)?.t ?? this.time(event.offsetX));
    });
    canvas.addEventListener("pointermove", event => {
      if (event.buttons) clock.seek(this.time(event.offsetX));
      else canvas.title = this.marked(event.offsetX)?.text ?? "";
    });
  }

  x(t) { return timeX(t, this.clock, this.canvas.clientWidth); }

  time(x) { return timeAtX(x, this.clock, this.canvas.clientWidth); }

  // The impact whose mark is under the pointer.
  marked(x) {
    const near = this.impacts.filter(impact => Math.abs(this.x(impact.t) - x) <= px(4));
    return near.sort((a, b) => Math.abs(this.x(a.t) - x) - Math.abs(this.x(b.t) - x))[0];
  }

  draw() {
    const {clock, canvas} = this;
    if (!canvas.clientWidth) return;
    const context = contextOf(canvas);
    const [left, right, now] = [this.x(clock.begin), this.x(clock.end), this.x(clock.t)];
    context.fillStyle = theme.colour("line");
    context.fillRect(left, px(11), right - left, px(5));
    context.fillStyle = theme.colour("press");
    context.fillRect(left, px(11), now - left, px(5));
    context.fillStyle = theme.colour("impact");
    for (const {t} of this.impacts) context.fillRect(this.x(t) - px(0.75), px(1), px(1.5), px(10));
    context.fillStyle = theme.colour("faint");
    context.font = font(10.5);
    context.textAlign = "center";
    const times = clock.end > clock.begin ? ticks(clock.begin, clock.end, Math.max(2, (right - left) / px(90))) : [clock.begin];
    for (const t of times) {
      context.fillRect(this.x(t), px(16), 1, px(4));
      context.fillText(onAxis(t, times[1] - times[0] || 1), this.x(t), px(30));
    }
    context.textAlign = "right";
    context.fillText("t [s]", left - px(14), px(30));
    context.beginPath();
    context.arc(now, px(13.5), px(7), 0, 2 * Math.PI);
    context.fillStyle = theme.colour("press");
    context.fill();
    context.lineWidth = px(2);
    context.strokeStyle = "white";
    context.stroke();
    canvas.setAttribute("aria-valuenow", clock.t);
    canvas.setAttribute("aria-valuetext", clock.told);
  }
}

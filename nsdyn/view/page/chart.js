// A plot on a canvas: axes, areas, lines; and over it, on a canvas of its own, the cursor.

const MARGIN = {top: 8, bottom: 5};  // and to the sides those of the timeline below, which has the axis
const GAP = 11;  // between lanes
const SMALLEST = 0.7;  // of the size of a text, to make room
const SAME = 5e-3, MOST = 0.9;  // curves lie on each other that are no further apart, of a range, for so much of their time
const TURN = 8;  // length of their dashes

class Chart {
  // `onSeek(t)` is called where the pointer is pressed or drawn.
  constructor(place, onSeek) {
    this.place = place;
    this.back = place.appendChild(element("canvas"));
    this.front = place.appendChild(element("canvas"));
    const seek = event => { if (event.buttons) onSeek(this.time(event.offsetX)); };
    place.addEventListener("pointerdown", event => { place.setPointerCapture(event.pointerId); seek(event); });
    place.addEventListener("pointermove", seek);
    this.lanes = [];
  }

  // What is shown: {begin, end} of time, and lanes, one above the other, each {low, high, log, unit, areas, lines, note};
  // what else is to be said of a lane, its `remark`, stands with the figures, off the curves.
  // An area is {values: [lower, upper], colour}, a line {values, colour, dash, shift, width, rim}; all have the times `t`,
  // but for lines that have their own; `steps` where each value is of the time since the one before.
  show(content) {
    Object.assign(this, content);
    this.redraw();
  }

  x(t) { return timeX(t, this, this.width); }

  time(x) { return timeAtX(x, this, this.width); }

  box(lane) {
    const room = (this.height - px(MARGIN.top + MARGIN.bottom - GAP)) / this.lanes.length;
    const top = px(MARGIN.top) + room * this.lanes.indexOf(lane);
    return {top, bottom: top + room - px(GAP)};
  }

  y(lane, value) {
    const {top, bottom} = this.box(lane);
    const f = lane.log ? Math.log10 : x => x;
    const part = (f(value) - f(lane.low)) / (f(lane.high) - f(lane.low));
    return bottom - (bottom - top) * Math.min(1.02, part);
  }

  redraw() {
    this.width = this.back.clientWidth;
    this.height = this.back.clientHeight;
    if (!this.width || !this.height) return;
    const context = contextOf(this.back);
    context.font = font(10.5);
    for (const lane of this.lanes) this.drawLane(context, lane);
    this.cursor(this.now ?? this.begin);
  }

  drawLane(context, lane) {
    const {top, bottom} = this.box(lane);
    const [left, right] = [px(EDGES.left), this.width - px(EDGES.right)];
    context.fillStyle = theme.colour("faint");
    context.textAlign = "right";
    const count = (bottom - top) / px(22);
    const step = roundStep((lane.high - lane.low) / count);
    const linear = lane.note ? [0] : ticks(lane.low, lane.high, count);  // of nothing, no numbers
    const marks = lane.log ? decades(lane.low, lane.high, (bottom - top) / px(16)) : linear;
    for (const mark of marks) {
      const y = Math.round(this.y(lane, mark)) + 0.5;
      drawLine(context, [[left, y], [right, y]], theme.colour("grid"), 1);
      const text = lane.log ? powerOfTen(Math.round(Math.log10(mark))) : onAxis(mark, step);
      context.fillText(text, left - px(5), y + px(3.5));
    }
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top + 1);
    context.clip();
    for (const {values: [lower, upper], colour} of lane.areas ?? []) {
      context.fillStyle = colour;
      context.beginPath();
      this.trace(context, lane, upper);
      this.trace(context, lane, lower, true);
      context.fill();
    }
    for (const {values, colour, dash, shift, width, t, rim} of lane.lines ?? []) {
      context.lineCap = shift === undefined ? "round" : "butt";
      context.setLineDash(dash ?? []);
      context.lineDashOffset = shift ?? 0;
      context.beginPath();
      this.trace(context, lane, values, false, t);
      for (const [stroke, more] of rim ? [[theme.colour("paper"), 1.6], [colour, 0]] : [[colour, 0]]) {
        context.strokeStyle = stroke;
        context.lineWidth = px(width + more);
        context.stroke();
      }
    }
    context.restore();
    context.textAlign = "left";
    // Upright beside the axis, somewhat smaller if need be, and else over the curves.
    const part = Math.min(1, (bottom - top + px(GAP) - px(4)) / context.measureText(lane.unit).width);
    if (part < SMALLEST) {
      context.fillStyle = theme.colour("veil");
      context.fillRect(left + 2, top, context.measureText(lane.unit).width + px(7), px(15));
      context.fillStyle = theme.colour("ink");
      context.fillText(lane.unit, left + px(5), top + px(11));
    }
    context.textAlign = "center";
    context.fillStyle = theme.colour("faint");
    context.save();
    context.translate(px(12), 0.5 * (top + bottom));
    context.rotate(-Math.PI / 2);
    context.font = font(10.5 * part);
    if (part >= SMALLEST) context.fillText(lane.unit, 0, 0);
    context.restore();
  }

  // Add a curve to the path; what is not finite leaves a gap. On a logarithmic axis, where one step may have nothing and
  // the next has much, each has a dash of its own: joined they would be a comb.
  trace(context, lane, values, backwards = false, t = this.t) {
    const count = values.length;
    let pen = backwards;
    for (let i = 0; i < count; i++) {
      const k = backwards ? count - 1 - i : i;
      if (!Number.isFinite(values[k]) || (lane.log && values[k] < lane.low)) {
        pen = false;
        continue;
      }
      const [x, y] = [this.x(t[k]), this.y(lane, values[k])];
      if (this.steps && k > 0) {
        const before = this.x(t[k - 1]);
        if (lane.log) pen = false;
        for (const corner of backwards ? [x, before] : [before, x]) {
          if (pen) context.lineTo(corner, y); else context.moveTo(corner, y);
          pen = true;
        }
      } else if (!this.steps) {
        if (pen) context.lineTo(x, y); else context.moveTo(x, y);
        pen = true;
      }
    }
  }

  cursor(t) {
    this.now = t;
    if (!this.width) return;
    const context = contextOf(this.front);
    const x = Math.round(this.x(t)) + 0.5;
    drawLine(context, [[x, px(MARGIN.top - 4)], [x, this.height]], theme.colour("accent"), px(1.5));
    // Words in the middle of a lane, which the cursor does not strike through.
    context.font = font(12);
    context.textAlign = "center";
    for (const lane of this.lanes.filter(({note}) => note)) {
      const {top, bottom} = this.box(lane);
      const [middle, width] = [0.5 * this.width, context.measureText(lane.note).width + px(12)];
      context.fillStyle = theme.colour("paper");
      context.fillRect(middle - 0.5 * width, 0.5 * (top + bottom) - px(10), width, px(20));
      context.fillStyle = theme.colour("faint");
      context.fillText(lane.note, middle, 0.5 * (top + bottom) + px(4));
    }
  }
}

// One range for the curves of a recording, the first, and those of the ones beside it, unless the curves of one would be
// too small to see in it and none is `laid` over another.
function commonRange(ranges, laid) {
  const all = [Math.min(...ranges.map(range => range[0])), Math.max(...ranges.map(range => range[1]))];
  const seen = ranges.every(([low, high]) => high - low > 0.2 * (all[1] - all[0]));
  return laid || seen ? all : ranges[0];
}

// Lines of one time of which those that lie on others for nearly all of the time in which they are not 0 take turns, so
// that all are seen; the first of each pile is whole, for the gaps of the others. As in the plots of `nsdyn.view.panels`.
function takingTurns(lines, range) {
  const near = SAME * range, piles = [];
  const lies = (values, others) => {
    let [some, same] = [0, 0];
    values.forEach((x, k) => {
      if (!(Math.max(Math.abs(x), Math.abs(others[k])) > near)) return;
      some++;
      if (Math.abs(x - others[k]) <= near) same++;
    });
    return same > MOST * some;
  };
  for (const line of lines) {
    const pile = piles.find(([first]) => lies(line.values, first.values));
    if (pile) pile.push(line); else piles.push([line]);
  }
  for (const pile of piles) {
    pile.slice(1).forEach((line, k) => {
      Object.assign(line, {dash: [TURN, TURN * (pile.length - 1)].map(px), shift: px(TURN * (pile.length - 1 - k))});
    });
  }
  return lines;
}

// A curve of one recording over those of another.
function dotted(t, values, colour) {
  const other = colour.match(/[0-9a-f]{2}/g).map(part => parseInt(part, 16)).map(
    part => Math.round(theme.dark ? 255 - 0.65 * (255 - part) : 0.65 * part));
  return {t, values, colour: `rgb(${other})`, dash: [0, 5], width: 2.6, rim: true};
}

// Powers of ten in a range, so many at most.
function decades(low, high, most) {
  const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
  const step = Math.max(1, Math.ceil((last - first + 1) / Math.max(1, most)));
  const out = [];
  for (let k = first; k <= last; k += step) out.push(10 ** k);
  return out;
}

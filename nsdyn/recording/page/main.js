// The page: its recordings on one clock.

async function main() {
  const texts = Array.from(document.querySelectorAll("script.recording"), script => script.textContent);
  const recordings = await Promise.all(texts.map(text => Recording.unpack(text)));
  const clock = new Clock(Math.min(...recordings.map(r => r.begin)), Math.max(...recordings.map(r => r.end)));
  if (recordings[0].picture || location.hash.startsWith("#picture")) document.body.classList.add("picture");
  const panes = recordings.map(recording => new Pane(recording, clock));
  const energy = common(panes.map(pane => pane.ledger.extremes()));
  const power = common(panes.map(pane => pane.ledger.powerExtremes()));
  for (const pane of panes) pane.ranges = {energy, power};
  const states = Float64Array.from(new Set(recordings.flatMap(r => Array.from(r.t)))).sort();
  const dock = new Dock(
    clock, states, recordings.flatMap(impactsOf).sort((a, b) => a.t - b.t),
    Math.min(...recordings.map(r => r.dt)));
  notes(recordings);
  for (const pane of panes) {
    clock.listeners.push(t => pane.seek(t));
    pane.show("energy");
    pane.stage.resize();
  }
  window.addEventListener("resize", () => dock.draw());
  const asked = location.hash.match(/t=([0-9.eE+-]+)/);
  const still = asked || document.body.classList.contains("picture");
  const start = recordings[0].picture ? recordings[0].t[0] : asked ? Number(asked[1]) : clock.begin;
  // A time, drawn as a scene that stands still, at once.
  const show = t => {
    clock.seek(t);
    for (const pane of panes) pane.stage.still();
  };
  window.nsdyn = {recordings, clock, dock, panes, show};
  show(start);
  if (!still) clock.play();
  window.ready = true;
}

// One range for curves that are to be compared; none where one of them would be too small to see in it.
function common(ranges) {
  const out = [Math.min(...ranges.map(range => range[0])), Math.max(...ranges.map(range => range[1]))];
  return ranges.every(([low, high]) => high - low > 0.2 * (out[1] - out[0])) ? out : null;
}

// When there were impacts, and words for the pointer.
function impactsOf(recording) {
  const a = recording.arrays;
  return Array.from(a["impacts/t"], (t, k) => {
    const names = [0, 1].map(side => recording.bodies[recording.geoms[a["impacts/geoms"][2 * k + side]].body].name);
    const [speed, impulse] = [withUnit(a["impacts/speed"][k], "m/s"), withUnit(a["impacts/impulse"][k], "N·s")];
    return {t, text: `impact at ${t.toPrecision(5)} s: ${names.join(" – ")}, ${speed}, ${impulse}`};
  });
}

function notes(recordings) {
  const lines = recordings.map(({name, notes: all}) => (recordings.length > 1 ? `${name}: ` : "") + all.join("; "));
  document.getElementById("notes").textContent = lines.join(" | ");
}

main().catch(error => {
  window.failure = error;
  document.getElementById("notes").textContent = `This page cannot be shown: ${error.message}`;
  throw error;
});

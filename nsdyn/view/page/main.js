// The page: its recordings on one clock, seen from one place.

async function main() {
  const texts = Array.from(document.querySelectorAll("script.recording"), script => script.textContent);
  const recordings = await Promise.all(texts.map(text => Recording.unpack(text)));
  const clock = new Clock(
    Math.min(...recordings.map(r => r.begin)), Math.max(...recordings.map(r => r.end)),
    Math.min(...recordings.map(r => r.dt)));
  const picture = recordings[0].picture || location.hash.startsWith("#picture");
  document.body.classList.toggle("picture", picture);
  document.body.classList.toggle("film", location.hash.includes("film"));
  const curves = location.hash.match(/curves=(\w+)/);  // that a film has too
  document.body.classList.toggle("curved", picture && curves !== null);
  theme.start(picture);
  document.body.classList.toggle("two", recordings.length > 1);
  document.body.style.setProperty("--count", recordings.length);
  oneScale(recordings);
  const panes = recordings.map(recording => new Pane(recording, clock));
  const stages = panes.map(pane => pane.stage);
  panes.forEach((pane, k) => {
    pane.stage.together = stages;
    pane.others = panes.filter(other => other !== pane);
    clock.listeners.push(t => pane.seek(t));
  });
  if (picture) panes.at(-1).root.querySelector(".view").append(document.getElementById("dock"));  // of which it has the clock
  const tools = new Tools(panes);
  if (curves) tools.show(curves[1]);
  const states = Float64Array.from(new Set(recordings.flatMap(r => Array.from(r.t)))).sort();
  const dock = new Dock(clock, states, recordings.flatMap(r => r.impacts).sort((a, b) => a.t - b.t));
  notes(recordings);
  for (const stage of stages) stage.resize();
  if (document.body.classList.contains("film")) for (const stage of stages) stage.begin();
  const asked = timeAsked();
  const inside = window.parent !== window;  // of a notebook, of which there may be many: they wait to be played
  const still = inside || asked !== null || document.body.classList.contains("picture");
  const start = recordings[0].picture ? recordings[0].t[0] : asked ?? clock.begin;
  // A time, drawn as a scene that stands still, at once.
  const show = t => {
    clock.seek(t);
    for (const stage of stages) stage.still();
  };
  window.nsdyn = {recordings, clock, dock, panes, tools, show};
  if (!inside && !document.body.classList.contains("picture")) linkTo(clock);
  show(start);
  if (!still) clock.play();
  window.ready = true;
}

// Forces of all recordings are as long as those of the one that has the largest.
function oneScale(recordings) {
  const touching = recordings.filter(recording => recording.contacts);
  for (const layer of ["forces", "cones"]) {
    const most = Math.max(...touching.map(({units}) => units[layer]));
    for (const {units} of touching) units[layer] = most;
  }
}

// The time in the address, null if there is none.
function timeAsked() {
  const asked = location.hash.match(/t=([0-9.eE+-]+)/);
  return asked && Number(asked[1]);
}

// The address points at the time shown as soon as that rests, for browsers refuse addresses that change more often than
// 200 times in 30 s; and the time at the address that is given.
function linkTo(clock) {
  const page = location.href.split("#")[0];
  let rest;
  clock.listeners.push(t => {
    clearTimeout(rest);
    const write = () => history.replaceState(history.state, "", `${page}#t=${Number(t.toPrecision(12))}`);
    if (!clock.playing) rest = setTimeout(write, 200);
  });
  window.addEventListener("hashchange", () => {
    clock.pause();
    clock.seek(timeAsked() ?? clock.t);
  });
}

function notes(recordings) {
  const lines = recordings.map(({label, notes: all}) => (recordings.length > 1 ? `${label}: ` : "") + all.join("; "));
  document.getElementById("notes").textContent = lines.join(" | ");
}

main().catch(error => {
  window.failure = error;
  document.getElementById("panes").replaceChildren(element("p", "failure", `This page cannot be shown: ${error.message}`));
  throw error;
});

"""Pages of recordings in a browser, each opened once for the tests in a row that look at it."""

from nsdyn.view import viewer

SIZE = (1000, 700)

# What a page shows: all of its elements, which has the focus, and what is drawn from where, to round-off.
STATE = """
(({panes, clock}) => JSON.stringify([
  document.documentElement.className, document.activeElement.tagName, clock.t, clock.playing,
  ...Array.from(document.querySelectorAll("body > :not(script)"), e => e.outerHTML),
  panes.map(({stage, overlay, chart}) => [
    stage.camera.position, stage.viewer.controls.target, stage.camera.fov, stage.preset, stage.moved, stage.followed,
    stage.width, stage.height, overlay.layers, overlay.selected, overlay.marked, overlay.trail,
    chart.height, chart.lanes.map(({unit, low, high}) => [unit, low, high])]),
], (_, value) => typeof value === "number" ? value.toPrecision(12) : value))(nsdyn)
"""
RESTED = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
# By its buttons, as a user does; a page that is late draws what moves with fewer pixels.
BACK = f"""
(async ({{panes, clock, dock, tools, show}}, {{t, pressed}}) => {{
  clock.pause();
  dock.setSpeed(1);
  document.getElementById("help").close();
  document.activeElement.blur();
  tools.show("energy");
  document.querySelectorAll(".tools [aria-pressed]").forEach((button, k) => {{
    if (button.getAttribute("aria-pressed") !== pressed[k]) button.click();
  }});
  for (const {{inspector, stage}} of panes) {{
    inspector.clear();
    Object.assign(stage.quality, {{moving: 0, late: 0}});
  }}
  document.querySelector(".tools .home").click();
  show(t);
  await {RESTED};
  return {STATE.strip()};
}})(nsdyn, opening)
"""
OPENING = f"""
(async () => {{
  const pressed = Array.from(document.querySelectorAll(".tools [aria-pressed]"), b => b.getAttribute("aria-pressed"));
  window.opening = {{t: nsdyn.clock.t, pressed}};
  nsdyn.show(opening.t);
  await {RESTED};
  return {STATE.strip()};
}})()
"""


class Opener:
    """What opens the page of a recording at a time, or takes the one that shows it back to how it was opened.

    A page that cannot be taken back, by what `STATE` sees of it, is opened anew.
    """

    def __init__(self, window, folder):
        self.window, self.path = window, folder / "page.html"
        self.key = self.state = None

    def __call__(self, trajectory, size=SIZE, at="#t=0", **options):
        key = (trajectory, size, at, options)
        if self.key == key and self.window.run("'opening' in window"):
            self.window.resize(size)
            self.window.run(RESTED)
            if self.window.run(BACK) == self.state:
                return self.window
        viewer.write_html(trajectory, self.path, **options)
        self.window.open(self.path.as_uri() + at, size)
        self.key = None
        if at.startswith("#t="):
            self.key = key
            self.state = self.window.run(OPENING)
        return self.window

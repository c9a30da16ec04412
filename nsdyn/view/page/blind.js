// What stands in for the 3D part where a browser has no WebGL: the curves are shown all the same.

class Blind {
  constructor(place, reason) {
    Object.assign(this, {drawn: [], followed: null, preset: "home"});
    this.viewer = {set_dirty() {}, gui: {domElement: element("div"), open() {}, close() {}}};
    place.append(element("p", "blind", `This browser draws no 3D picture: ${reason} The curves are those of the recording.`));
    document.body.classList.add("blind");
  }

  seek() {}
  still() {}
  resize() {}
  look() {}
  follow() {}
  pick() { return null; }
  showCollision() {}
  begin() {}
}

function stageFor(place, recording) {
  try {
    return new Stage(place, recording);
  } catch (error) {
    place.replaceChildren();
    return new Blind(place, error.message);
  }
}

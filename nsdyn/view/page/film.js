// Pictures of a film, in which the camera stands still: the background and the ground are drawn once, and each picture only
// where bodies and their shadows are.

const ROOM = 1.15;  // times its radius that a ball takes on the screen, towards the edges of which it is an ellipse

class Film {
  constructor(stage) {
    this.stage = stage;
    const {viewer, grounds, shapes, looks} = stage;
    const canvas = viewer.renderer.domElement;
    const others = [...shapes, ...looks].filter(node => node.visible && !grounds.includes(node));
    for (const node of others) node.visible = false;
    viewer.render();
    canvas.style.background = `url(${canvas.toDataURL()}) 0 0 / 100% 100%`;
    for (const node of others) node.visible = true;
    viewer.hide_background();
    for (const ground of grounds) {
      ground.traverse(object => {
        if (!object.material?.vertexColors) return;
        // Of several, one hides the shadows on others that lie behind it.
        if (grounds.length > 1 && object.isMesh) object.material.colorWrite = false; else object.visible = false;
      });
    }
    // Where half-spaces meet: these lines are in the background and, as they may be before bodies, drawn over what is
    // drawn of a picture, but nowhere else, for twice they are darker.
    const {CustomBlending, DstAlphaFactor, OneMinusDstAlphaFactor, ZeroFactor, OneFactor} = MeshCat.THREE;
    viewer.scene.traverse(object => {
      if (!object.isLineSegments || stage.edges.includes(object)) return;
      object.renderOrder = 1;
      Object.assign(object.material, {
        transparent: true, blending: CustomBlending, blendSrc: DstAlphaFactor, blendDst: OneMinusDstAlphaFactor,
        blendSrcAlpha: ZeroFactor, blendDstAlpha: OneFactor});
    });
    this.bodies = [];
    for (const node of others) node.traverse(object => { if (object.geometry) this.bodies.push(object); });
    for (const {geometry} of this.bodies) if (!geometry.boundingSphere) geometry.computeBoundingSphere();
    // Bodies from the front to the back: what others hide need not be shaded.
    const away = ({geometry: {boundingSphere: {center}}, matrixWorld}) => (
      center.clone().applyMatrix4(matrixWorld).distanceTo(stage.camera.position));
    viewer.renderer.setOpaqueSort((a, b) => a.renderOrder - b.renderOrder || away(a.object) - away(b.object));
  }

  // The next picture changes nothing outside of the rectangle around bodies and shadows.
  cut() {
    const {stage, stage: {viewer: {renderer}, width, height}} = this;
    renderer.setScissorTest(false);
    renderer.clear();
    let [left, right, top, bottom] = [width, 0, height, 0];
    for (const [centre, radius] of this.balls()) {
      const at = stage.project(centre);
      const size = at && ROOM * radius * height / (2 * stage.slope * at[2]) + 2;
      if (!at) [left, right, top, bottom] = [0, width, 0, height];
      else {
        [left, right] = [Math.min(left, at[0] - size), Math.max(right, at[0] + size)];
        [top, bottom] = [Math.min(top, at[1] - size), Math.max(bottom, at[1] + size)];
      }
    }
    [left, right, top, bottom] = [Math.max(0, left), Math.min(width, right), Math.max(0, top), Math.min(height, bottom)];
    renderer.setScissorTest(true);
    renderer.setScissor(left, height - bottom, Math.max(0, right - left), Math.max(0, bottom - top));
  }

  // Balls [centre, radius] around bodies and around their shadows on half-spaces, world.
  balls() {
    const {sun, viewer, recording: {view: {planes}}} = this.stage;
    viewer.scene.updateMatrixWorld();
    const world = v => [v.x, -v.z, v.y];
    const [from, to] = [sun, sun.target].map(({matrixWorld}) => sun.position.clone().setFromMatrixPosition(matrixWorld));
    const ray = world(to.sub(from).normalize());
    const along = (normal, v) => normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2];
    return this.bodies.flatMap(({geometry: {boundingSphere: {center, radius}}, matrixWorld}) => {
      const [x, r] = [world(center.clone().applyMatrix4(matrixWorld)), radius * matrixWorld.getMaxScaleOnAxis()];
      const shadows = planes.filter(plane => along(plane, ray) < 0).map(plane => {
        const slope = -along(plane, ray);
        const way = (along(plane, x) - plane[3]) / slope;
        return [x.map((value, i) => value + way * ray[i]), r / slope];
      });
      return [[x, r], ...shadows];
    });
  }
}

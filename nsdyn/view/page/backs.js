// Which meshes nobody sees from behind, so that half of their triangles need not be drawn: where those that are seen from
// behind are left out of pictures from all around, the same mesh is seen there still. Files say nothing of it, and what
// winds around a solid by most of its area may yet be open to the eye, and the reverse.

const SIDES = 128;  // pixels of the pictures
const OPEN = 0.05;  // of the pixels of a mesh that are another's, or nobody's, without its backs

// A set of those of the meshes that are to be drawn from both sides.
function seenFromBehind({meshes, shapes, looks, viewer: {renderer, scene}}) {
  const {DoubleSide, FrontSide, ShaderMaterial, WebGLRenderTarget} = MeshCat.THREE;
  const numbered = new ShaderMaterial({
    uniforms: {number: {value: 0}},
    vertexShader: "void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: `uniform float number;
      void main() { gl_FragColor = vec4(mod(number, 256.0) / 255.0, floor(number / 256.0) / 255.0, 0.0, 1.0); }`,
  });
  const nodes = [...shapes, ...looks];
  const before = {
    materials: meshes.map(mesh => mesh.material), background: scene.background, shown: nodes.map(node => node.visible)};
  meshes.forEach((mesh, k) => {
    mesh.material = numbered.clone();
    mesh.material.uniforms.number.value = k + 1;
  });
  nodes.forEach((node, k) => { node.visible = k >= shapes.length; });
  scene.background = null;
  renderer.shadowMap.enabled = false;
  const target = new WebGLRenderTarget(SIDES, SIDES);
  renderer.setRenderTarget(target);
  const [all, lost] = [new Uint32Array(meshes.length + 1), new Uint32Array(meshes.length + 1)];
  for (const camera of around(meshes)) {
    const [both, front] = [DoubleSide, FrontSide].map(side => {
      const pixels = new Uint8Array(4 * SIDES * SIDES);
      for (const {material} of meshes) material.side = side;
      renderer.render(scene, camera);
      renderer.readRenderTargetPixels(target, 0, 0, SIDES, SIDES, pixels);
      return new Uint32Array(pixels.buffer).map(rgba => rgba & 0xffff);
    });
    both.forEach((number, k) => {
      all[number]++;
      if (front[k] !== number) lost[number]++;
    });
  }
  renderer.setRenderTarget(null);
  target.dispose();
  renderer.shadowMap.enabled = true;
  scene.background = before.background;
  nodes.forEach((node, k) => { node.visible = before.shown[k]; });
  meshes.forEach((mesh, k) => { mesh.material = before.materials[k]; });
  return new Set(meshes.filter((_, k) => lost[k + 1] > OPEN * all[k + 1]));
}

// Cameras around the meshes as they are: before their sides, edges and corners.
function around(meshes) {
  const {Box3, OrthographicCamera, Vector3} = MeshCat.THREE;
  const box = new Box3();
  for (const mesh of meshes) box.expandByObject(mesh);
  const [centre, radius] = [box.getCenter(new Vector3()), box.getSize(new Vector3()).length() / 2];
  return Array.from({length: 27}, (_, k) => [k % 3 - 1, Math.floor(k / 3) % 3 - 1, Math.floor(k / 9) - 1])
    .filter(direction => Math.hypot(...direction) > 0)
    .map(direction => {
      const camera = new OrthographicCamera(-radius, radius, radius, -radius, 0, 2 * radius);
      const away = new Vector3(...direction).setLength(radius);
      camera.position.copy(centre).add(away);
      if (direction[0] === 0 && direction[2] === 0) camera.up.set(0, 0, 1);
      camera.lookAt(centre);
      return camera;
    });
}

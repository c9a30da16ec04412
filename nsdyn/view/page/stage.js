// The 3D part: meshcat's viewer, its camera, and where things are on the screen.
//
// three.js has y up, recordings have z up: (x, y, z) there is (x, z, -y) in the viewer.

// Where pictures take longer than SLOW ms, as where software draws them, those of a moving scene get fewer pixels, no
// shadows, no edges, meshes with fewer triangles: [pixels per pixel of the page, shadows, edges]. A scene that stands
// still is drawn as the first.
const QUALITIES = [[1, true, true], [0.7, false, true], [0.5, false, false], [0.35, false, false]];
const SLOW = 30;
const LATE = 150;  // ms that pictures may be late in all before they get worse
const STILL = 200;  // ms without a picture

const VIEWS = {home: null, front: [0, 0], side: [90, 0], top: [0, 89.99]};  // azimuth, elevation in degrees
const PARALLEL = 0.1;  // degrees that all but the first see: from so far away lines stay parallel to a pixel
const FILTERED = /shadow = \(\s*texture2DCompare\( shadowMap, shadowCoord\.xy \+ vec2\( dx0, dy0 \)[^]*?17\.0 \);/;
const FINE = 2;  // pixels of a film of meshes for each that it shows, each way
const NIGHT = 0.14;  // how bright the ground is in the dark

// What four points of a shadow's map tell, weighted by how near they are, in place of the 17 that three.js asks for.
const chunks = MeshCat.THREE.ShaderChunk;
chunks.shadowmap_pars_fragment = chunks.shadowmap_pars_fragment.replace(FILTERED, `
  vec2 at = shadowCoord.xy * shadowMapSize - 0.5;
  vec2 part = fract(at);
  vec2 low = (at - part + 0.5) * texelSize;
  vec2 high = low + texelSize;
  float z = shadowCoord.z;
  shadow = mix(
    mix(texture2DCompare(shadowMap, low, z), texture2DCompare(shadowMap, vec2(high.x, low.y), z), part.x),
    mix(texture2DCompare(shadowMap, vec2(low.x, high.y), z), texture2DCompare(shadowMap, high, z), part.x), part.y);`);

class Stage {
  constructor(place, recording) {
    Object.assign(this, {place, recording});
    this.drawn = [];  // called after each picture
    const film = document.body.classList.contains("film");
    const many = film && recording.looks.some(({mesh}) => mesh !== null);
    this.viewer = new MeshCat.Viewer(place, true, many ? fine(place) : undefined);
    if (many) this.viewer.renderer.setPixelRatio(FINE);
    this.viewer.set_3d_pane_size = () => this.resize();
    for (const command of recording.commands()) this.viewer.handle_command_bytearray(command);
    // The edges of a room, which meshcat lets cast shadows: dashes on its walls.
    this.viewer.scene.traverse(object => { if (object.isLineSegments) object.castShadow = false; });
    const sun = this.viewer.scene_tree.find(["Lights", "Sun", "<object>"]).object;
    const {centre} = recording.view;
    sun.target.position.set(centre[0], centre[2], -centre[1]);
    sun.target.updateMatrixWorld();
    this.viewer.set_animation(recording.animations(), {play: false});
    this.animator = this.viewer.animator;
    this.animator.play();  // makes the tracks active; time is the page's own
    this.animator.pause();
    const nodes = paths => paths.map(path => this.viewer.scene_tree.find(pathOf(path)).object);
    this.frames = nodes(recording.frames);
    this.shapes = nodes(recording.geoms.map(geom => geom.path));
    this.looks = nodes(recording.looks.map(look => look.path));
    const meshes = new Meshes(recording);
    this.meshes = [];
    this.coarse = new Coarse(this);
    recording.looks.forEach(({mesh}, k) => {
      if (mesh === null) return;
      this.looks[k].traverse(object => {
        if (!object.isMesh) return;
        meshes.fill(object, mesh);
        this.meshes.push(object);
      });
    });
    this.showCollision(false);
    this.followed = null;
    this.moved = false;  // whether the user has turned the camera
    this.together = [this];  // stages of which all have the place of one camera
    this.viewer.controls.addEventListener("start", () => { for (const stage of this.together) stage.moved = true; });
    this.viewer.controls.addEventListener("change", () => this.share());
    this.viewer.renderer.shadowMap.type = MeshCat.THREE.PCFShadowMap;
    if (film) {  // it has many pictures a second
      sun.shadow.mapSize.set(1024, 1024);
      sun.shadow.normalBias *= 2;
    }
    this.quality = {moving: 0, now: 0, last: null, late: 0, still: false};
    this.sun = sun;
    this.edges = [];
    for (const shape of [...this.shapes, ...this.looks]) shape.traverse(object => { if (object.isLineSegments) this.edges.push(object); });
    const render = this.viewer.render.bind(this.viewer);
    this.viewer.render = () => {
      this.choose();
      this.stayAbove();
      this.clip();
      this.film?.cut();
      render();
      this.measure();
      for (const draw of this.drawn) draw();
    };
    this.sight = new Sight(this.shapes, recording.geoms);
    this.grounds = this.shapes.filter((_, k) => !recording.geoms[k].solid);
    this.shade();
    theme.listeners.push(() => this.shade());
    this.look("home");
  }

  // Collision shapes of robots that have visual ones, or those.
  showCollision(on) {
    this.shapes.forEach((node, k) => { if (this.recording.geoms[k].veiled) node.visible = on; });
    for (const node of this.looks) node.visible = !on;
    this.viewer.set_dirty();
  }

  // The background, and the ground that fades into it, by day or at night, with the lines that are seen on it then.
  shade() {
    const light = theme.dark ? NIGHT : 1;
    for (const name of ["top_color", "bottom_color"]) {
      this.viewer.set_property(["Background"], name, this.recording.view.background.map(c => c * light));
    }
    for (const ground of this.grounds) {
      ground.traverse(({material, geometry}) => {
        if (!material?.vertexColors) return;
        material.color.setScalar(light);
        const {night, day, color} = geometry.attributes;
        if (!night) return;
        geometry.setAttribute("day", day ?? color);
        geometry.setAttribute("color", theme.dark ? night : day ?? color);
      });
    }
    this.viewer.set_dirty();
  }

  // For a film, in which the camera stands still.
  begin() {
    this.coarse.show(this.pixelsPerMetre);
    this.coarse.cast(0.5 * this.pixelsPerMetre);
    this.film = new Film(this);
  }

  get camera() { return this.viewer.camera; }

  // Takes the other cameras to where this one is.
  share() {
    for (const {camera, viewer} of this.together) {
      if (viewer === this.viewer) continue;
      camera.position.copy(this.camera.position);
      camera.fov = this.camera.fov;
      viewer.controls.target.copy(this.viewer.controls.target);
      viewer.set_dirty();
    }
  }

  resize() {
    const {clientWidth: width, clientHeight: height} = this.viewer.dom_element;
    if (!width || !height) return;
    this.viewer.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.moved) this.look(this.preset);
    this.viewer.render();  // at once, for what was drawn is gone
  }

  // To a time: the bodies, and the camera if it follows one.
  seek(t) {
    this.animator.seek(t - this.recording.begin);
    if (this.followed !== null) {
      const place = this.origin(this.followed.frame);
      const by = place.map((x, k) => x - this.followed.place[k]);
      this.followed.place = place;
      for (const vector of [this.camera.position, this.viewer.controls.target]) {
        vector.set(vector.x + by[0], vector.y + by[2], vector.z - by[1]);
      }
      this.share();
    }
    this.viewer.set_dirty();
  }

  // Quality of the next picture: the pictures of a moving scene follow each other, and get worse while they are late.
  choose() {
    const {quality} = this;
    if (quality.still || document.body.classList.contains("picture")) return;
    const now = performance.now();
    if (quality.last) quality.late += Math.max(0, now - quality.last - SLOW);
    quality.last = now;
    if (quality.late > LATE && quality.moving < QUALITIES.length - 1) {
      quality.moving++;
      quality.late = 0;
    }
    this.draw(quality.moving);
    // It is at rest when nothing follows what the browser has shown.
    clearTimeout(quality.rest);
    cancelAnimationFrame(quality.shown);
    quality.shown = requestAnimationFrame(() => { quality.rest = setTimeout(() => this.still(), STILL); });
  }

  // Draw at once, as a scene that stands still. Of bodies that are all where they were a film has the picture before, and
  // over it anew what is drawn on it.
  still() {
    const places = this.frames.flatMap(frame => [...frame.position.toArray(), ...frame.quaternion.toArray()]).join();
    const same = places === this.places && document.body.classList.contains("film");
    this.places = places;
    if (same) {
      this.viewer.needs_render = false;
      for (const draw of this.drawn) draw();
      return;
    }
    this.quality.last = null;
    this.quality.still = true;
    this.draw(0);
    this.viewer.render();
    this.quality.still = false;
  }

  draw(quality) {
    if (quality === this.quality.now) return;
    this.quality.now = quality;
    const [pixels, shadows, edges] = QUALITIES[quality];
    this.sun.castShadow = shadows;
    for (const object of this.edges) object.visible = edges;
    this.coarse.show(quality && pixels * this.pixelsPerMetre);
    this.viewer.renderer.setPixelRatio(pixels);
  }

  follow(frame) {
    for (const stage of this.together) {
      stage.followed = null;
      stage.viewer.set_dirty();
    }
    if (frame !== null) this.followed = {frame, place: this.origin(frame)};
  }

  // A preset direction from which all that ever moves is in the picture, whatever the window's proportions.
  look(preset) {
    const {centre, field, back} = this.recording.view;
    for (const stage of this.together) Object.assign(stage, {preset, moved: false});
    let towards = back;
    this.camera.fov = VIEWS[preset] ? PARALLEL : field;
    const {slope} = this;
    if (VIEWS[preset]) {
      const [azimuth, elevation] = VIEWS[preset].map(angle => angle * Math.PI / 180);
      const flat = Math.cos(elevation);
      towards = [flat * Math.sin(azimuth), -flat * Math.cos(azimuth), Math.sin(elevation)];
    }
    const size = Math.hypot(towards[0], towards[1]);
    const right = [-towards[1] / size, towards[0] / size, 0];
    const up = cross(towards, right);
    const along = (p, d) => p.reduce((sum, x, k) => sum + (x - centre[k]) * d[k], 0);
    const outline = this.recording.arrays.outline;
    const aspect = Math.min(...this.together.map(stage => stage.camera.aspect));
    const left = 1 - 2 * this.covered;
    const free = left > 0.5 ? left : 1;  // in small windows a heading may lie over the scene
    let distance = 0;
    for (let k = 0; k < outline.length; k += 4) {
      const [point, r] = [Array.from(outline.subarray(k, k + 3)), outline[k + 3]];
      const high = (Math.abs(along(point, up)) + r) / (slope * free);
      const wide = (Math.abs(along(point, right)) + r) / (slope * aspect);
      distance = Math.max(distance, along(point, towards) + 1.08 * Math.max(high, wide));
    }
    const eye = centre.map((x, k) => x + distance * towards[k]);
    this.camera.position.set(eye[0], eye[2], -eye[1]);
    this.viewer.controls.target.set(centre[0], centre[2], -centre[1]);
    for (const stage of this.together) {
      if (stage.followed) stage.followed.place = stage.origin(stage.followed.frame);
    }
    this.viewer.set_dirty();
    this.share();
  }

  // Part of the view's height that its heading is over, as on pictures.
  get covered() {
    const {top, height} = this.place.getBoundingClientRect();
    return Math.max(0, this.place.closest(".pane").querySelector(".heading").getBoundingClientRect().bottom - top) / height;
  }

  // Height of what is seen at a distance of 1, halved.
  get slope() { return Math.tan(this.camera.fov * Math.PI / 360); }

  // What is seen lies within some radii of the scene: depths as fine as they can be.
  clip() {
    const {camera, viewer, recording: {view: {radius}}} = this;
    const distance = camera.position.distanceTo(viewer.controls.target);
    camera.near = Math.max(0.01 * radius, distance - 20 * radius);
    camera.far = distance + 100 * radius;
    camera.updateProjectionMatrix();
  }

  // Lift the camera out of half-spaces on which things stand.
  stayAbove() {
    const {planes, radius} = this.recording.view;
    const p = this.camera.position;
    for (const [nx, ny, nz, offset] of planes) {
      const lift = 0.02 * radius - (nx * p.x - ny * p.z + nz * p.y - offset);
      if (nz > 0.3 && lift > 0) p.set(p.x + lift * nx, p.y + lift * nz, p.z - lift * ny);
    }
  }

  // Place of the origin of a moving frame, world.
  origin(frame) { return this.frames[frame].position.toArray(); }

  // World vector of one in the axes of a moving frame.
  turned(frame, v) {
    const {x, y, z, w} = this.frames[frame].quaternion;
    const axis = [x, y, z];
    const turn = cross(axis, v).map(c => 2 * c);
    const twice = cross(axis, turn);
    return v.map((c, k) => c + w * turn[k] + twice[k]);
  }

  // What takes world coordinates to the screen, after a picture.
  measure() {
    const {camera, viewer} = this;
    this.toClip = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).multiply(viewer.scene.matrixWorld);
    this.width = viewer.dom_element.clientWidth;
    this.height = viewer.dom_element.clientHeight;
  }

  // Pixels of a world point, and its depth along the view in m; null behind the camera.
  project(p) {
    const [x, y, , w] = homogeneous(this.toClip.elements, p);
    if (w <= 0) return null;
    return [0.5 * this.width * (1 + x / w), 0.5 * this.height * (1 - y / w), w];
  }

  // Pixels of a metre in the middle of the picture.
  get pixelsPerMetre() {
    const depth = this.camera.position.distanceTo(this.viewer.controls.target);
    return this.height / (2 * this.slope * depth);
  }

  // Number of the body in front at a pixel, or null.
  pick(x, y) {
    const toClip = this.camera.projectionMatrix.clone().multiply(this.camera.matrixWorldInverse);
    let best = {depth: Infinity, body: null};
    const {geoms, looks} = this.recording;
    const shown = [...this.shapes, ...this.looks].map((node, k) => ({node, body: [...geoms, ...looks][k].body}));
    for (const {node, body} of shown) node.traverseVisible(object => {
      if (!object.isMesh) return;
      // A ray in the object's own axes: depths 0 and 1 of the screen, taken back.
      const inverse = toClip.clone().multiply(object.matrixWorld).invert();
      const [from, to] = [-1, 1].map(z => {
        const [a, b, c, w] = homogeneous(inverse.elements, [2 * x / this.width - 1, 1 - 2 * y / this.height, z]);
        return [a / w, b / w, c / w];
      });
      const depth = firstHit(object.geometry, from, to);
      if (depth < best.depth) best = {depth, body};
    });
    return best.body;
  }
}

// What draws films of meshes: four pixels for each that is shown take half the time that llvmpipe takes for four samples of
// each, where triangles are as many as pixels.
function fine(place) {
  const renderer = new MeshCat.THREE.WebGLRenderer({alpha: true});
  renderer.shadowMap.enabled = true;
  place.append(renderer.domElement);
  return renderer;
}

// Smallest fraction of the way from one point to another at which a front face of a mesh is (Möller and Trumbore 1997).
function firstHit(geometry, from, to) {
  const position = geometry.attributes.position;
  const corner = k => geometry.index ? geometry.index.array[k] : k;
  const at = k => position.array.subarray(3 * k, 3 * k + 3);
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const way = minus(to, from);
  const count = geometry.index ? geometry.index.count : position.count;
  let best = Infinity;
  for (let k = 0; k < count; k += 3) {
    const [a, b, c] = [at(corner(k)), at(corner(k + 1)), at(corner(k + 2))];
    const [e1, e2] = [minus(b, a), minus(c, a)];
    const p = cross(way, e2);
    const det = dot(e1, p);
    if (det <= 0) continue;
    const s = minus(from, a);
    const u = dot(s, p) / det;
    if (u < 0 || u > 1) continue;
    const q = cross(s, e1);
    const v = dot(way, q) / det;
    const depth = dot(e2, q) / det;
    if (v >= 0 && u + v <= 1 && depth > 0 && depth < best) best = depth;
  }
  return best;
}

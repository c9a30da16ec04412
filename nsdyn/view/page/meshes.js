// Visual meshes: triangles as they are drawn, smooth but where they have edges.

const EDGE = 0.8;  // cosine between triangles of a corner beyond which there is an edge between them

class Meshes {
  constructor({arrays}) {
    this.arrays = arrays;
    this.filled = new Map();
  }

  part(name, k) {
    const ends = this.arrays[`meshes/${name}_ends`];
    return this.arrays[`meshes/${name}`].subarray(k ? ends[k - 1] : 0, ends[k]);
  }

  // Give a mesh of three.js the triangles of a number; those of the same number share them.
  fill(object, k) {
    if (!this.filled.has(k)) {
      const {geometry} = object;
      const Attribute = geometry.attributes.position.constructor;
      const {position, normal} = creased(this.part("position", k), this.part("index", k));
      geometry.setAttribute("position", new Attribute(position, 3));
      geometry.setAttribute("normal", new Attribute(normal, 3));
      this.filled.set(k, geometry);
    }
    object.geometry = this.filled.get(k);
  }
}

// Corners of triangles, and at each the mean normal of the triangles there that turn away from its own by no edge.
function creased(points, index) {
  const position = new Float32Array(3 * index.length);
  const normal = new Float32Array(3 * index.length);
  const [area, unit] = [new Float32Array(index.length), new Float32Array(index.length)];
  const around = Array.from({length: points.length / 3}, () => []);
  index.forEach((vertex, corner) => {
    position.set(points.subarray(3 * vertex, 3 * vertex + 3), 3 * corner);
    around[vertex].push(3 * Math.floor(corner / 3));
  });
  for (let at = 0; at < index.length; at += 3) {
    const [a, b, c] = [0, 3, 6].map(k => position.subarray(3 * at + k, 3 * at + k + 3));
    const n = cross([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
    const size = Math.hypot(...n) || 1;
    for (let i = 0; i < 3; i++) [area[at + i], unit[at + i]] = [n[i], n[i] / size];
  }
  index.forEach((vertex, corner) => {
    const own = 3 * Math.floor(corner / 3);
    for (const at of around[vertex]) {
      if (unit[at] * unit[own] + unit[at + 1] * unit[own + 1] + unit[at + 2] * unit[own + 2] < EDGE) continue;
      for (let i = 0; i < 3; i++) normal[3 * corner + i] += area[at + i];
    }
    const size = Math.hypot(...normal.subarray(3 * corner, 3 * corner + 3)) || 1;
    for (let i = 0; i < 3; i++) normal[3 * corner + i] /= size;
  });
  return {position, normal};
}

// Whether a point of a contact is seen or behind bodies: how far the line to the camera runs inside of shapes, all of
// which are convex. A point on a surface that is seen has no way inside.

const INSIDE = 0.04;  // of the shape's radius, that may be inside
const SKIN = 0.01;  // of it, that planes are moved inwards: what runs along a face or an edge does not run inside

class Sight {
  // `shapes` are nodes of three.js by the number of their shape, `geoms` what the recording tells of them.
  constructor(shapes, geoms) {
    this.solids = shapes.map((node, k) => geoms[k].solid && Sight.solid(node)).filter(Boolean);
    const radii = this.solids.map(({radius}) => radius).sort((a, b) => a - b);
    this.usual = radii[Math.floor(radii.length / 2)] ?? 1;  // radius
  }

  // Planes [n, offset] that bound the meshes of a node, in its axes, and a ball around them.
  static solid(node) {
    node.updateMatrixWorld(true);
    const inverse = node.matrixWorld.clone().invert();
    const corners = [];
    node.traverse(object => {
      if (!object.isMesh) return;
      const toNode = inverse.clone().multiply(object.matrixWorld).elements;
      const {position} = object.geometry.attributes;
      const index = object.geometry.index?.array ?? Array.from({length: position.count}, (_, k) => k);
      const at = k => transformed(toNode, position.array.subarray(3 * index[k]));
      for (let k = 0; k < index.length; k++) corners.push(at(k));
    });
    const end = (i, f) => corners.reduce((most, x) => f(most, x[i]), corners[0][i]);
    const middle = [0, 1, 2].map(i => 0.5 * (end(i, Math.min) + end(i, Math.max)));
    const radius = corners.reduce((most, x) => Math.max(most, Math.hypot(...x.map((c, i) => c - middle[i]))), 0);
    const planes = new Map();
    for (let k = 0; k < corners.length; k += 3) {
      const [a, b, c] = corners.slice(k, k + 3);
      const n = cross(b.map((x, i) => x - a[i]), c.map((x, i) => x - a[i]));
      const size = Math.hypot(...n);
      if (size < 1e-12 * radius * radius) continue;
      const plane = [...n.map(x => x / size), (n[0] * a[0] + n[1] * a[1] + n[2] * a[2]) / size];
      planes.set(plane.map((x, i) => Math.round(x * 1e3 / (i < 3 ? 1 : radius || 1))).join(), plane);
    }
    for (const plane of planes.values()) plane[3] -= SKIN * radius;
    return {node, middle, radius, planes: Array.from(planes.values())};
  }

  // Where the shapes and the camera are now, before points are asked for.
  look(camera) {
    this.eye = camera.position.toArray();
    this.balls = Float64Array.from(this.solids.flatMap(({node, middle, radius}) => (
      [...transformed(node.matrixWorld.elements, middle), radius])));
    this.inverses = new Array(this.solids.length);
  }

  // Whether something is before a point, world.
  hides([x, y, z]) {
    const point = [x, z, -y];
    const way = this.eye.map((c, k) => c - point[k]);
    const length = Math.hypot(...way);
    const [dx, dy, dz] = way.map(c => c / length);
    for (let k = 0; k < this.solids.length; k++) {  // of hundreds, for each of hundreds of points: without objects
      const radius = this.balls[4 * k + 3];
      const cx = this.balls[4 * k] - x, cy = this.balls[4 * k + 1] - z, cz = this.balls[4 * k + 2] + y;
      const along = cx * dx + cy * dy + cz * dz;
      if (along < -radius || cx * cx + cy * cy + cz * cz - along * along > radius * radius) continue;
      const {node, planes} = this.solids[k];
      const inverse = this.inverses[k] ??= node.matrixWorld.clone().invert().elements;
      if (Sight.chord(inverse, planes, transformed(inverse, point), [dx, dy, dz]) > INSIDE * radius) return true;
    }
    return false;
  }

  // Length of a ray from a point in the axes of a solid, with a direction of the world, inside of the solid.
  static chord(m, planes, p, d) {
    const dx = m[0] * d[0] + m[4] * d[1] + m[8] * d[2];
    const dy = m[1] * d[0] + m[5] * d[1] + m[9] * d[2];
    const dz = m[2] * d[0] + m[6] * d[1] + m[10] * d[2];
    let from = 0, to = Infinity;
    for (const n of planes) {
      const left = n[3] - n[0] * p[0] - n[1] * p[1] - n[2] * p[2];
      const speed = n[0] * dx + n[1] * dy + n[2] * dz;
      if (Math.abs(speed) < 1e-12) {
        if (left < 0) return 0;
      } else if (speed > 0) {
        to = Math.min(to, left / speed);
      } else {
        from = Math.max(from, left / speed);
      }
      if (to <= from) return 0;
    }
    return to - from;
  }
}

// A point taken by the elements of a matrix, and its weight in perspective.
function homogeneous(m, [x, y, z]) { return [0, 1, 2, 3].map(k => m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k]); }

function transformed(m, point) { return homogeneous(m, point).slice(0, 3); }

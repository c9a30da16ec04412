// Meshes with fewer triangles, for pictures that are gone at once: corners in the same cell of a grid become one, where
// the planes of the triangles around them are nearest in the mean of squares (Lindstrom 2000). The triangles that are
// left keep their normals: what is round is shaded as before.

const CELL = 2;  // pixels
const LEVELS = 2;  // of cells, within a factor of two
const STIFF = 0.02;  // what draws a corner to the mean of those it stands for, beside the planes

class Coarse {
  constructor(stage) {
    this.stage = stage;
    this.made = new Map();  // of geometries, by their cells
  }

  // Shows all meshes in full, or as they need to be where a metre has so many pixels.
  show(pixelsPerMetre) {
    const {meshes} = this.stage;
    if (pixelsPerMetre && meshes.length) this.both ??= seenFromBehind(this.stage);
    for (const object of meshes) {
      const {geometry, side} = object.userData.full ??= {geometry: object.geometry, side: object.material.side};
      object.geometry = pixelsPerMetre ? this.get(geometry, object, pixelsPerMetre) : geometry;
      const shown = pixelsPerMetre && !this.both.has(object) ? MeshCat.THREE.FrontSide : side;
      object.material.needsUpdate = shown !== object.material.side;
      object.material.side = shown;
    }
  }

  // Shadows, of which the map has fewer points than a picture, are cast by meshes as they need to be for so many pixels.
  cast(pixelsPerMetre) {
    const {meshes, viewer: {renderer: {shadowMap}}} = this.stage;
    const render = shadowMap.render.bind(shadowMap);
    const casting = meshes.map(object => this.get(object.userData.full.geometry, object, pixelsPerMetre));
    shadowMap.render = (...scene) => {
      const shown = meshes.map(object => object.geometry);
      meshes.forEach((object, k) => { object.geometry = casting[k]; });
      render(...scene);
      meshes.forEach((object, k) => { object.geometry = shown[k]; });
    };
  }

  get(geometry, object, pixelsPerMetre) {
    if (!this.made.has(geometry)) this.made.set(geometry, new Map());
    const levels = this.made.get(geometry);
    const scale = Math.cbrt(Math.abs(object.matrixWorld.determinant()));
    const level = Math.round(LEVELS * Math.log2(CELL / pixelsPerMetre / scale));
    if (!levels.has(level)) levels.set(level, coarser(geometry, 2 ** (level / LEVELS)));
    return levels.get(level);
  }
}

function coarser(geometry, size) {
  const {position: {array: x, constructor: Attribute}, normal: {array: normals}} = geometry.attributes;
  const [cell, count] = cells(x, size);
  const at = representatives(x, cell, count, size);
  const [position, normal, seen] = [[], [], new Set()];
  for (let k = 0; k < cell.length; k += 3) {
    const corners = [cell[k], cell[k + 1], cell[k + 2]];
    if (new Set(corners).size < 3) continue;
    // One that turns the other way is another: the far side of a thin plate.
    const first = corners.indexOf(Math.min(...corners));
    const name = [0, 1, 2].map(i => corners[(first + i) % 3]).join();
    if (seen.has(name)) continue;
    seen.add(name);
    corners.forEach((c, i) => {
      position.push(at[3 * c], at[3 * c + 1], at[3 * c + 2]);
      normal.push(normals[3 * (k + i)], normals[3 * (k + i) + 1], normals[3 * (k + i) + 2]);
    });
  }
  const out = new geometry.constructor();
  out.setAttribute("position", new Attribute(new Float32Array(position), 3));
  out.setAttribute("normal", new Attribute(new Float32Array(normal), 3));
  return out;
}

// Of every corner the number of its cell, and how many there are.
function cells(x, size) {
  const numbers = new Map();
  const out = new Int32Array(x.length / 3);
  for (let k = 0; k < out.length; k++) {
    const place = [0, 1, 2].reduce((sum, i) => sum * 131072 + Math.floor(x[3 * k + i] / size), 0);
    if (!numbers.has(place)) numbers.set(place, numbers.size);
    out[k] = numbers.get(place);
  }
  return [out, numbers.size];
}

// The point of each cell: Σ area n nᵀ y = Σ area n (nᵀ d) of its triangles, at y from the mean m of its corners, with
// d from there to the triangle; no further than a cell.
function representatives(x, cell, count, size) {
  const [mean, number] = [new Float64Array(3 * count), new Float64Array(count)];
  cell.forEach((c, k) => {
    number[c]++;
    for (let i = 0; i < 3; i++) mean[3 * c + i] += x[3 * k + i];
  });
  mean.forEach((sum, k) => { mean[k] = sum / number[Math.floor(k / 3)]; });
  const sums = new Float64Array(12 * count);  // the matrix by rows, then the right-hand side
  for (let k = 0; k < cell.length; k += 3) {
    const corner = i => [x[3 * (k + i)], x[3 * (k + i) + 1], x[3 * (k + i) + 2]];
    const [a, b, c] = [corner(0), corner(1), corner(2)];
    const area = cross([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
    const weight = Math.hypot(...area) || 1;
    for (let corner = k; corner < k + 3; corner++) {
      const [m, row] = [3 * cell[corner], 12 * cell[corner]];
      const away = area[0] * (a[0] - mean[m]) + area[1] * (a[1] - mean[m + 1]) + area[2] * (a[2] - mean[m + 2]);
      for (let i = 0; i < 3; i++) {
        for (let j = 0; j < 3; j++) sums[row + 3 * i + j] += area[i] * area[j] / weight;
        sums[row + 9 + i] += area[i] * away / weight;
      }
    }
  }
  for (let c = 0; c < count; c++) {
    const rows = [0, 3, 6, 9].map(i => Array.from(sums.subarray(12 * c + i, 12 * c + i + 3)));
    const stiff = STIFF * (rows[0][0] + rows[1][1] + rows[2][2]);
    for (let i = 0; i < 3; i++) rows[i][i] += stiff;
    const inverse = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])];
    const volume = rows[0].reduce((sum, value, i) => sum + value * inverse[0][i], 0);
    for (let i = 0; i < 3 && volume > 0; i++) {
      const y = inverse.reduce((sum, column, j) => sum + column[i] * rows[3][j], 0) / volume;
      mean[3 * c + i] += Math.max(-size, Math.min(size, y));
    }
  }
  return mean;
}

// The road: its surface, the lines on it, posts and rails beside it, and the ground around. The world's x and y are the
// drawing's x and −z; up is y.

import * as THREE from "three";

const LINE_M = 0.15;
const DASH_M = 3;
const GAP_M = 4.5;
const POST_EVERY_M = 12;
const RAIL_M = 0.62;

const at = ([x, y], height) => [x, height, -y];

/** A surface between two rows of points. */
function strip(left, right, height) {
  const positions = [];
  const places = [];
  const index = [];
  let way = 0;
  left.forEach((point, i) => {
    if (i > 0) way += Math.hypot(point[0] - left[i - 1][0], point[1] - left[i - 1][1]);
    positions.push(...at(point, height), ...at(right[i], height));
    places.push(0, way, 1, way);
    if (i > 0) index.push(2 * i - 2, 2 * i - 1, 2 * i, 2 * i, 2 * i - 1, 2 * i + 1);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  geometry.setAttribute("uv", new THREE.Float32BufferAttribute(places, 2));
  geometry.setIndex(index);
  geometry.computeVertexNormals();
  return geometry;
}

/** Places along a line, with the direction there. */
function walk(points) {
  const legs = [];
  let length = 0;
  for (let i = 1; i < points.length; i++) {
    const [x, y] = points[i - 1];
    const [dx, dy] = [points[i][0] - x, points[i][1] - y];
    const leg = Math.hypot(dx, dy);
    if (leg > 0) legs.push({ from: length, leg, x, y, ux: dx / leg, uy: dy / leg });
    length += leg;
  }
  const place = (s) => {
    const leg = legs.findLast((leg) => leg.from <= s) ?? legs[0];
    const along = s - leg.from;
    return { x: leg.x + leg.ux * along, y: leg.y + leg.uy * along, ux: leg.ux, uy: leg.uy };
  };
  return { length, place };
}

function stripe(points, from, to) {
  const { place } = walk(points);
  const [left, right] = [[], []];
  const steps = Math.max(1, Math.ceil((to - from) / 2));
  for (let i = 0; i <= steps; i++) {
    const { x, y, ux, uy } = place(from + ((to - from) * i) / steps);
    left.push([x - (uy * LINE_M) / 2, y + (ux * LINE_M) / 2]);
    right.push([x + (uy * LINE_M) / 2, y - (ux * LINE_M) / 2]);
  }
  return strip(left, right, 0.012);
}

function merge(geometries) {
  const positions = [];
  const normals = [];
  const index = [];
  for (const geometry of geometries) {
    const first = positions.length / 3;
    positions.push(...geometry.attributes.position.array);
    normals.push(...geometry.attributes.normal.array);
    index.push(...[...geometry.index.array].map((i) => first + i));
  }
  const merged = new THREE.BufferGeometry();
  merged.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  merged.setAttribute("normal", new THREE.Float32BufferAttribute(normals, 3));
  merged.setIndex(index);
  return merged;
}

/** Grain, so that one sees the ground move. The same on every machine: the noise is a fixed sequence. */
function grain(size, base, spread, repeat) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = size;
  const context = canvas.getContext("2d");
  const image = context.createImageData(size, size);
  let seed = 1;
  for (let i = 0; i < image.data.length; i += 4) {
    seed = (seed * 16807) % 2147483647;
    const noise = (seed / 2147483647 - 0.5) * spread;
    for (let c = 0; c < 3; c++) image.data[i + c] = base[c] + noise;
    image.data[i + 3] = 255;
  }
  context.putImageData(image, 0, 0);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.repeat.set(...repeat);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 4;
  return texture;
}

export function makeRoad(road, fog) {
  const group = new THREE.Group();
  const material = (options) => fog.cover(new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, ...options }));
  const left = road.surface.map(([point]) => point);
  const right = road.surface.map(([, point]) => point);
  const middle = left.map(([x, y], i) => [(x + right[i][0]) / 2, (y + right[i][1]) / 2]);

  const asphalt = grain(128, [74, 78, 83], 34, [4, 0.3]);
  group.add(new THREE.Mesh(strip(left, right, 0), material({ map: asphalt })));

  const stripes = road.lines.flatMap(({ points, dashed }) => {
    const { length } = walk(points);
    if (!dashed) return [stripe(points, 0, length)];
    const dashes = [];
    for (let s = 0; s + DASH_M < length; s += DASH_M + GAP_M) dashes.push(stripe(points, s, s + DASH_M));
    return dashes;
  });
  group.add(new THREE.Mesh(merge(stripes), material({ color: 0xe9ebe6, emissive: 0x30322f })));

  const centre = middle[Math.floor(middle.length / 2)];
  const grass = grain(128, [92, 104, 74], 44, [260, 260]);
  const ground = new THREE.Mesh(new THREE.PlaneGeometry(2400, 2400).rotateX(-Math.PI / 2), material({ map: grass }));
  ground.position.set(centre[0], -0.06, -centre[1]);
  group.add(ground);

  // Rails on both sides, and the posts that carry them.
  const outwards = (side, away) =>
    side.map(([x, y], i) => {
      const [mx, my] = middle[i];
      const width = Math.hypot(x - mx, y - my) || 1;
      return [x + ((x - mx) / width) * away, y + ((y - my) / width) * away];
    });
  const rails = [left, right].flatMap((side) => {
    const line = outwards(side, 0.5);
    const [low, high] = [RAIL_M - 0.16, RAIL_M + 0.14];
    const geometry = strip(line, line, 0);
    const positions = geometry.attributes.position;
    for (let i = 0; i < positions.count; i++) positions.setY(i, i % 2 ? low : high);
    return [geometry];
  });
  const steel = new THREE.MeshBasicMaterial({ color: 0x878f95, side: THREE.DoubleSide });
  group.add(new THREE.Mesh(merge(rails), fog.cover(steel)));

  const places = [left, right].flatMap((side) => {
    const { length, place } = walk(outwards(side, 0.55));
    return Array.from({ length: Math.floor(length / POST_EVERY_M) }, (_, i) => place(i * POST_EVERY_M));
  });
  const posts = new THREE.InstancedMesh(
    new THREE.BoxGeometry(0.1, 0.95, 0.1),
    material({ color: 0xd8dcdc }),
    places.length,
  );
  const caps = new THREE.InstancedMesh(
    new THREE.BoxGeometry(0.11, 0.14, 0.11),
    material({ color: 0xffa84a, emissive: 0x8a4a10 }),
    places.length,
  );
  places.forEach(({ x, y }, i) => {
    posts.setMatrixAt(i, new THREE.Matrix4().makeTranslation(x, 0.47, -y));
    caps.setMatrixAt(i, new THREE.Matrix4().makeTranslation(x, 0.8, -y));
  });
  group.add(posts, caps);

  group.add(makeTrees(left, right, middle, material));
  return group;
}

/** Trees at some distance, for clear weather: in fog nobody sees them. */
function makeTrees(left, right, middle, material) {
  const places = [];
  let seed = 7;
  const draw = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let i = 0; i < middle.length; i += 2) {
    for (const side of [left, right]) {
      if (draw() < 0.45) continue;
      const [mx, my] = middle[i];
      const [dx, dy] = [side[i][0] - mx, side[i][1] - my];
      const width = Math.hypot(dx, dy) || 1;
      const away = width + 9 + 46 * draw() ** 1.5;
      places.push([mx + (dx / width) * away, my + (dy / width) * away, 0.75 + 0.7 * draw()]);
    }
  }
  const crowns = new THREE.InstancedMesh(
    new THREE.ConeGeometry(2.1, 6.4, 7).translate(0, 4.6, 0),
    material({ color: 0x3f5a41, flatShading: true }),
    places.length,
  );
  const trunks = new THREE.InstancedMesh(
    new THREE.CylinderGeometry(0.22, 0.3, 1.8, 6).translate(0, 0.8, 0),
    material({ color: 0x5b4a3c }),
    places.length,
  );
  places.forEach(([x, y, size], i) => {
    const matrix = new THREE.Matrix4().makeScale(size, size, size).setPosition(x, 0, -y);
    crowns.setMatrixAt(i, matrix);
    trunks.setMatrixAt(i, matrix);
  });
  const group = new THREE.Group();
  group.add(crowns, trunks);
  return group;
}

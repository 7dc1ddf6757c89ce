// Cars, drawn from a few shapes: body, windows, wheels and lights. Sized as the world says.

import * as THREE from "three";

/** Paints, so that one car can be told from another. */
const PAINTS = [0x7c8fa6, 0xb8bcc2, 0x8c4a43, 0x35506e, 0x6b7a5e, 0xc3b08a, 0x50545c, 0x9a9fa8];
const LENGTH_M = 4.7;
const WIDTH_M = 1.85;
const HEIGHT_M = 1.48;

function profile(points) {
  const shape = new THREE.Shape();
  points.forEach(([x, y], index) => (index === 0 ? shape.moveTo(x, y) : shape.lineTo(x, y)));
  shape.closePath();
  return shape;
}

function extrude(points, width, bevel) {
  const geometry = new THREE.ExtrudeGeometry(profile(points), {
    depth: width - 2 * bevel,
    bevelEnabled: true,
    bevelThickness: bevel,
    bevelSize: bevel * 0.6,
    bevelSegments: 3,
    curveSegments: 4,
  });
  geometry.translate(0, 0, -(width - 2 * bevel) / 2);
  geometry.computeVertexNormals();
  return geometry;
}

export class CarYard {
  constructor(fog) {
    const material = (options) => fog.cover(new THREE.MeshLambertMaterial(options));
    this.body = extrude(
      [[-2.28, 0.36], [-2.3, 0.86], [-2.05, 0.96], [-0.9, 0.98], [0.95, 0.98], [2.05, 0.82], [2.28, 0.66], [2.28, 0.36]],
      WIDTH_M,
      0.1,
    );
    this.cabin = extrude([[-1.85, 0.94], [-1.25, 1.42], [0.15, 1.45], [1.05, 0.94]], WIDTH_M - 0.3, 0.09);
    this.roof = extrude([[-1.2, 1.42], [-1.1, 1.46], [0.05, 1.48], [0.2, 1.44]], WIDTH_M - 0.36, 0.06);
    this.wheel = new THREE.CylinderGeometry(0.33, 0.33, 0.24, 18).rotateX(Math.PI / 2);
    this.lamp = new THREE.BoxGeometry(0.06, 0.14, 0.42);
    this.shade = new THREE.PlaneGeometry(LENGTH_M + 0.5, WIDTH_M + 0.45).rotateX(-Math.PI / 2);
    this.glass = material({ color: 0x161b22 });
    this.tyre = material({ color: 0x14161a });
    this.front = material({ color: 0xffffff, emissive: 0xf4f1dc });
    this.tail = material({ color: 0x55110f, emissive: 0x7a1411 });
    this.brake = material({ color: 0xff3a2d, emissive: 0xff3424 });
    this.ground = fog.cover(
      new THREE.MeshBasicMaterial({ color: 0x0c0e11, transparent: true, opacity: 0.42, depthWrite: false }),
    );
    this.paints = PAINTS.map((color) => material({ color }));
  }

  make(id, length, width, isTall) {
    const car = new THREE.Group();
    const part = (geometry, material, x = 0, y = 0, z = 0) => {
      const mesh = new THREE.Mesh(geometry, material);
      mesh.position.set(x, y, z);
      car.add(mesh);
      return mesh;
    };
    const paint = this.paints[((id % PAINTS.length) + PAINTS.length) % PAINTS.length];
    part(this.shade, this.ground, 0, 0.02, 0);
    part(this.body, paint);
    part(this.cabin, this.glass);
    part(this.roof, paint);
    for (const x of [-1.38, 1.42]) for (const z of [-0.8, 0.8]) part(this.wheel, this.tyre, x, 0.33, z);
    for (const z of [-0.62, 0.62]) part(this.lamp, this.front, 2.31, 0.66, z);
    const lamps = [-0.64, 0.64].map((z) => part(this.lamp, this.tail, -2.33, 0.8, z));
    lamps.push(part(new THREE.BoxGeometry(0.04, 0.05, 0.6), this.tail, -1.62, 1.19, 0));
    car.scale.set(length / LENGTH_M, isTall ? 2 : 1, width / WIDTH_M);
    car.userData.height = isTall ? 2 * HEIGHT_M : HEIGHT_M;
    car.userData.setBrakes = (isBraking) => {
      for (const lamp of lamps) lamp.material = isBraking ? this.brake : this.tail;
    };
    return car;
  }
}

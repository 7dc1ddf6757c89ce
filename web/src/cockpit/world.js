// The view from the driver's seat, its mirror, and the head-up display: boxes around the cars that are pointed out.

import * as THREE from "three";
import { CarYard } from "./cars.js";
import { Fog } from "./fog.js";
import { makeRoad } from "./road.js";

const EYE = { ahead: 0.25, left: 0.36, height: 1.18 };
/** A car that slows by more than this shows its brake lights. */
const BRAKING_MPS2 = -0.7;
/** A picture that takes longer than this is slow; after so many of them the next ones are coarser. */
const SLOW_S = 0.035;
const SLOW_FRAMES = 12;
const COARSEST = 0.35;
const BOX_COLOUR = "#ffb340";

export class World {
  constructor(scene, canvas, hud, mirrorFrame) {
    this.canvas = canvas;
    this.hud = hud;
    this.pen = hud.getContext("2d");
    this.mirrorFrame = mirrorFrame;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.setScissorTest(true);
    this.fog = new Fog(scene.fog);
    this.scene = new THREE.Scene();
    this.scene.background = this.fog.colour;
    if (this.fog.isClear) this.scene.add(makeSky(this.fog.colour));
    this.scene.add(new THREE.HemisphereLight(0xdfe9f2, 0x6d6a60, 2.1));
    const sun = new THREE.DirectionalLight(0xfff3dd, this.fog.isClear ? 1.5 : 0.5);
    sun.position.set(-60, 90, 40);
    this.scene.add(sun, makeRoad(scene.road, this.fog));
    this.yard = new CarYard(this.fog);
    this.meshes = new Map();
    this.camera = new THREE.PerspectiveCamera(52, 1, 0.3, 1500);
    this.rear = new THREE.PerspectiveCamera(17, 4.2, 0.3, 1500);
    this.bonnet = makeBonnet();
    this.scene.add(this.bonnet);
    this.glass = makeGlass();
    this.boxes = new Set();
    this.drawn = [];
    this.frames = 0;
    this.slow = 0;
    this.quality = 1;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    const ratio = Math.min(window.devicePixelRatio, 2);
    this.renderer.setPixelRatio(ratio * this.quality);
    this.renderer.setSize(width, height, false);
    this.hud.width = width * ratio;
    this.hud.height = height * ratio;
    this.size = { width, height, ratio };
    this.mirror = this.mirrorFrame.getBoundingClientRect();
    this.glass.target.setSize(Math.max(1, this.mirror.width * ratio * this.quality), Math.max(1, this.mirror.height * ratio * this.quality));
  }

  /** Draws everybody as they are at `now`; `steer` turns nothing but the look into the bend. */
  draw(tracks, now, steer) {
    if (!tracks.ego || !this.size) return;
    const ego = tracks.ego.at(now);
    const [cos, sin] = [Math.cos(ego.heading), Math.sin(ego.heading)];
    const eye = {
      x: ego.x + cos * EYE.ahead - sin * EYE.left,
      y: ego.y + sin * EYE.ahead + cos * EYE.left,
    };
    this.fog.follow(ego.x, -ego.y, ego.heading);
    this.camera.position.set(eye.x, EYE.height, -eye.y);
    const look = ego.heading + 0.05 * steer;
    this.camera.lookAt(eye.x + 30 * Math.cos(look), EYE.height - 1.1, -(eye.y + 30 * Math.sin(look)));
    this.rear.position.set(ego.x, EYE.height + 0.12, -ego.y);
    this.rear.lookAt(ego.x - 30 * cos, EYE.height - 0.5, -(ego.y - 30 * sin));
    this.bonnet.position.set(ego.x, 0, -ego.y);
    this.bonnet.rotation.y = ego.heading;
    this.place(tracks, now);
    this.render();
    this.drawBoxes(tracks, now);
    this.frames += 1;
  }

  /** Draws coarser where this machine cannot keep up; `elapsed` is the time since the last picture, in seconds. */
  keepUp(elapsed) {
    this.slow = elapsed > SLOW_S ? this.slow + 1 : Math.max(0, this.slow - 1);
    if (this.slow < SLOW_FRAMES || this.quality <= COARSEST) return;
    this.slow = 0;
    this.quality = Math.max(COARSEST, this.quality * 0.7);
    this.resize();
  }

  place(tracks, now) {
    for (const [id, track] of tracks.cars) {
      let mesh = this.meshes.get(id);
      if (!mesh) {
        mesh = this.yard.make(id, track.length, track.width, track.isTall);
        this.meshes.set(id, mesh);
        this.scene.add(mesh);
      }
      const pose = track.at(now);
      mesh.position.set(pose.x, 0, -pose.y);
      mesh.rotation.y = pose.heading;
      mesh.userData.setBrakes(track.acceleration < BRAKING_MPS2);
    }
    for (const [id, mesh] of this.meshes) {
      if (tracks.cars.has(id)) continue;
      this.scene.remove(mesh);
      this.meshes.delete(id);
    }
  }

  render() {
    const { width, height } = this.size;
    this.renderer.setViewport(0, 0, width, height);
    this.renderer.setScissor(0, 0, width, height);
    this.renderer.render(this.scene, this.camera);
    const mirror = this.mirror;
    if (!mirror || mirror.width < 20) return;
    // Inside its frame, and seen the other way round, as mirrors are.
    const inset = 5;
    const [wide, high] = [mirror.width - 2 * inset, mirror.height - 2 * inset];
    this.rear.aspect = wide / high;
    this.rear.updateProjectionMatrix();
    this.bonnet.visible = false;
    this.renderer.setRenderTarget(this.glass.target);
    this.renderer.render(this.scene, this.rear);
    this.renderer.setRenderTarget(null);
    this.bonnet.visible = true;
    const [left, bottom] = [mirror.left + inset, height - mirror.bottom + inset];
    this.renderer.setViewport(left, bottom, wide, high);
    this.renderer.setScissor(left, bottom, wide, high);
    this.renderer.render(this.glass.scene, this.glass.camera);
  }

  /** Pixels of a car's box on the display: left, top, right, bottom; none behind the driver. */
  boxOf(track, now) {
    const pose = track.at(now);
    const [cos, sin] = [Math.cos(pose.heading), Math.sin(pose.heading)];
    const [half, side] = [track.length / 2 + 0.15, track.width / 2 + 0.15];
    const high = (track.isTall ? 3 : 1.5) + 0.15;
    const box = { left: Infinity, top: Infinity, right: -Infinity, bottom: -Infinity };
    const corner = new THREE.Vector3();
    let inFront = 0;
    for (const along of [-half, half])
      for (const across of [-side, side])
        for (const up of [0, high]) {
          corner.set(pose.x + along * cos - across * sin, up, -(pose.y + along * sin + across * cos));
          corner.applyMatrix4(this.camera.matrixWorldInverse);
          if (corner.z > -0.4) continue;
          inFront += 1;
          corner.applyMatrix4(this.camera.projectionMatrix);
          const [x, y] = [((corner.x + 1) / 2) * this.size.width, ((1 - corner.y) / 2) * this.size.height];
          box.left = Math.min(box.left, x);
          box.right = Math.max(box.right, x);
          box.top = Math.min(box.top, y);
          box.bottom = Math.max(box.bottom, y);
        }
    return inFront >= 4 ? box : null;
  }

  drawBoxes(tracks, now) {
    const { pen } = this;
    const { width, height, ratio } = this.size;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.drawn = [];
    for (const id of this.boxes) {
      const track = tracks.cars.get(id);
      const box = track && this.boxOf(track, now);
      if (!box || box.right < 0 || box.left > width) continue;
      this.drawn.push({ id, ...box });
      bracket(pen, box);
    }
  }
}

/** Corners around a car, with a quiet line between them. */
function bracket(pen, { left, top, right, bottom }) {
  const [width, height] = [right - left, bottom - top];
  const arm = Math.min(22, 0.32 * Math.min(width, height) + 4);
  const path = () => {
    pen.beginPath();
    for (const [x, sx] of [[left, 1], [right, -1]])
      for (const [y, sy] of [[top, 1], [bottom, -1]]) {
        pen.moveTo(x, y + sy * arm);
        pen.lineTo(x, y);
        pen.lineTo(x + sx * arm, y);
      }
  };
  pen.lineCap = pen.lineJoin = "round";
  pen.strokeStyle = "rgb(10 12 15 / 55%)";
  pen.lineWidth = 6;
  path();
  pen.stroke();
  pen.fillStyle = "rgb(255 179 64 / 9%)";
  pen.fillRect(left, top, width, height);
  pen.strokeStyle = "rgb(255 179 64 / 40%)";
  pen.lineWidth = 1;
  pen.strokeRect(left, top, width, height);
  pen.strokeStyle = BOX_COLOUR;
  pen.lineWidth = 3;
  path();
  pen.stroke();
}

/** What one sees of one's own car. */
function makeBonnet() {
  const group = new THREE.Group();
  const shape = new THREE.Shape();
  shape.moveTo(0.75, -0.82);
  shape.bezierCurveTo(1.7, -0.84, 2.15, -0.74, 2.28, -0.4);
  shape.lineTo(2.32, 0.4);
  shape.bezierCurveTo(2.15, 0.74, 1.7, 0.84, 0.75, 0.82);
  shape.closePath();
  const geometry = new THREE.ExtrudeGeometry(shape, { depth: 0.05, bevelSize: 0.05, bevelThickness: 0.06, bevelSegments: 4 });
  geometry.rotateX(-Math.PI / 2).rotateZ(-0.075).translate(0, 0.73, 0);
  group.add(new THREE.Mesh(geometry, new THREE.MeshPhongMaterial({ color: 0x22303f, specular: 0x39434f, shininess: 40 })));
  return group;
}

/** The mirror's glass: what its camera saw, left and right exchanged. */
function makeGlass() {
  const target = new THREE.WebGLRenderTarget(512, 122, { samples: 4, type: THREE.HalfFloatType });
  const glass = new THREE.PlaneGeometry(2, 2);
  const places = glass.attributes.uv;
  for (let i = 0; i < places.count; i++) places.setX(i, 1 - places.getX(i));
  const scene = new THREE.Scene();
  scene.add(new THREE.Mesh(glass, new THREE.MeshBasicMaterial({ map: target.texture, depthTest: false })));
  return { target, scene, camera: new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1) };
}

function makeSky(horizon) {
  const geometry = new THREE.SphereGeometry(1200, 24, 12);
  const colours = [];
  const [low, high] = [horizon, new THREE.Color(0x5d8fc4)];
  for (let i = 0; i < geometry.attributes.position.count; i++) {
    const share = Math.min(1, Math.max(0, geometry.attributes.position.getY(i) / 520));
    colours.push(...low.clone().lerp(high, share ** 0.7).toArray());
  }
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
  const sky = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.BackSide, depthWrite: false }));
  sky.onBeforeRender = (renderer, scene, camera) => {
    sky.position.copy(camera.position);
    sky.updateMatrixWorld();
  };
  return sky;
}

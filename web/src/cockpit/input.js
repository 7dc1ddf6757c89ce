// What the person does: keys, a gamepad, or a steering wheel with pedals, as throttle (brake negative) and steer (left
// positive), each within ±1.

import { clamp } from "../shared/dom.js";

const KEYS = {
  ArrowLeft: "left", KeyA: "left",
  ArrowRight: "right", KeyD: "right",
  ArrowUp: "throttle", KeyW: "throttle",
  ArrowDown: "brake", KeyS: "brake", Space: "brake",
};
/** How fast a key turns the wheel and lets it go, in full turns a second; pedals likewise. */
const STEER_PER_S = 2.2;
const RELEASE_PER_S = 4.5;
const PEDAL_PER_S = 5;
/** A key asks for no more than this sideways acceleration. */
const LATERAL_MPS2 = 2.6;
const STORE = "mirror.devices";
const IDLE = 0.04;

/** Where a calibrated device has its wheel and pedals: axes, and what they read at rest and at the end. */
export class Calibrations {
  constructor() {
    try {
      this.known = JSON.parse(localStorage.getItem(STORE)) ?? {};
    } catch {
      this.known = {};
    }
  }

  of(pad) {
    return this.known[pad.id];
  }

  save(pad, calibration) {
    this.known[pad.id] = calibration;
    localStorage.setItem(STORE, JSON.stringify(this.known));
  }

  forget(pad) {
    delete this.known[pad.id];
    localStorage.setItem(STORE, JSON.stringify(this.known));
  }
}

/** A reading between two that are known, 0 to 1. */
export const share = (value, from, to) => clamp((value - from) / (to - from || 1), 0, 1);

/** Every number that a device reports: axes, then buttons. */
export const readings = (pad) => [...pad.axes, ...pad.buttons.map((button) => button.value)];

/** Throttle and steer of a device. */
export function read(pad, calibration) {
  if (calibration) {
    const values = readings(pad);
    const pedal = ({ index, rest, end }) => share(values[index] ?? rest, rest, end);
    const { wheel } = calibration;
    const turned = values[wheel.index] ?? wheel.rest;
    const left = share(turned, wheel.rest, wheel.left);
    const right = share(turned, wheel.rest, wheel.right);
    return { steer: left - right, throttle: pedal(calibration.throttle) - pedal(calibration.brake) };
  }
  if (pad.mapping !== "standard") return null;
  const stick = pad.axes[0] ?? 0;
  const dead = Math.abs(stick) < 0.09 ? 0 : stick;
  const pressed = (index) => pad.buttons[index]?.value ?? 0;
  return { steer: -Math.sign(dead) * Math.abs(dead) ** 1.7, throttle: pressed(7) - pressed(6) };
}

export class Driver {
  constructor(ego) {
    this.ego = ego;
    this.held = new Set();
    this.steer = 0;
    this.throttle = 0;
    this.calibrations = new Calibrations();
    this.source = "keys";
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.held.clear());
  }

  key(event, isDown) {
    const does = KEYS[event.code];
    if (!does || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target instanceof HTMLButtonElement && event.code === "Space") return;
    event.preventDefault();
    if (isDown) this.held.add(does);
    else this.held.delete(does);
  }

  /** Devices that there are. */
  pads() {
    return [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected);
  }

  /** Reads the devices; `elapsed` seconds since the last time, `speed` in m/s. */
  update(elapsed, speed) {
    for (const pad of this.pads()) {
      const now = read(pad, this.calibrations.of(pad));
      if (!now) continue;
      const isUsed = Math.abs(now.steer) > IDLE || Math.abs(now.throttle) > IDLE;
      if (isUsed) this.source = pad.id;
      if (this.source === pad.id && !this.held.size) {
        [this.steer, this.throttle] = [now.steer, now.throttle];
        return;
      }
    }
    if (this.held.size) this.source = "keys";
    if (this.source !== "keys" && !this.pads().some((pad) => pad.id === this.source)) this.source = "keys";
    this.useKeys(elapsed, speed);
  }

  useKeys(elapsed, speed) {
    const wanted = Number(this.held.has("left")) - Number(this.held.has("right"));
    const most = this.mostSteer(speed);
    this.steer = approach(this.steer, wanted * most, elapsed, wanted ? STEER_PER_S * most : RELEASE_PER_S * most);
    const pedal = this.held.has("brake") ? -1 : Number(this.held.has("throttle"));
    this.throttle = approach(this.throttle, pedal, elapsed, PEDAL_PER_S);
  }

  /** The faster, the less a key turns the wheel. */
  mostSteer(speed) {
    const wheel = Math.atan((LATERAL_MPS2 * this.ego.wheelbase_m) / Math.max(speed, 3) ** 2);
    return clamp(wheel / ((this.ego.steer_deg * Math.PI) / 180), 0.08, 0.9);
  }
}

function approach(from, to, elapsed, rate) {
  const most = rate * elapsed;
  return from + clamp(to - from, -most, most);
}

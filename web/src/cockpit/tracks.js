// Where everybody is between two states of the world, which come twenty times a second: each car is carried on by its
// speed and turn from the newest state, and what the next state corrects fades out, so that nothing jumps and nothing
// lags behind.

import { turn } from "../shared/dom.js";

/** Time in which most of a correction has faded, in seconds. */
const FADE_S = 0.07;
/** A state is carried on no longer than this. */
const LONGEST_S = 0.25;
/** What is corrected by more than this has not moved but appeared elsewhere. */
const JUMP_M = 6;

class Track {
  constructor(state, time) {
    Object.assign(this, state);
    this.time = time;
    this.turnRate = 0;
    this.acceleration = 0;
    this.offset = { x: 0, y: 0, heading: 0 };
  }

  update(state, time) {
    const elapsed = (time - this.time) / 1000;
    const before = this.at(time);
    if (elapsed > 0.005) {
      const rate = turn(this.heading, state.heading) / elapsed;
      this.turnRate = Math.abs(rate) < 2 ? rate : 0;
      const acceleration = (state.speed - this.speed) / elapsed;
      this.acceleration += 0.5 * (acceleration - this.acceleration);
    }
    Object.assign(this, state);
    this.time = time;
    const offset = { x: before.x - this.x, y: before.y - this.y, heading: turn(this.heading, before.heading) };
    const jumped = Math.hypot(offset.x, offset.y) > JUMP_M;
    this.offset = jumped ? { x: 0, y: 0, heading: 0 } : offset;
  }

  /** Pose at a time of the page's clock. */
  at(now) {
    const ahead = Math.min(Math.max((now - this.time) / 1000, 0), LONGEST_S);
    const heading = this.heading + this.turnRate * ahead;
    const middle = this.heading + (this.turnRate * ahead) / 2;
    const way = this.speed * ahead;
    const left = Math.exp(-Math.max(now - this.time, 0) / 1000 / FADE_S);
    return {
      x: this.x + way * Math.cos(middle) + this.offset.x * left,
      y: this.y + way * Math.sin(middle) + this.offset.y * left,
      heading: heading + this.offset.heading * left,
      speed: this.speed,
    };
  }
}

/** All cars of an episode. */
export class Tracks {
  constructor() {
    this.ego = null;
    this.cars = new Map();
    this.episode = -1;
  }

  /** Takes in a state that arrived at `now`. */
  take(motion, now) {
    if (motion.e !== this.episode) {
      this.episode = motion.e;
      this.ego = null;
      this.cars.clear();
    }
    const [x, y, heading, speed] = motion.ego;
    const ego = { x, y, heading, speed };
    if (this.ego) this.ego.update(ego, now);
    else this.ego = new Track(ego, now);
    const present = new Set();
    for (const [id, x, y, heading, speed, length, width, isTall] of motion.cars) {
      present.add(id);
      const state = { x, y, heading, speed, length, width, isTall };
      const known = this.cars.get(id);
      if (known) known.update(state, now);
      else this.cars.set(id, new Track(state, now));
    }
    for (const id of this.cars.keys()) if (!present.has(id)) this.cars.delete(id);
  }

  /** While the world stands still, nobody is carried on. */
  freeze(now) {
    for (const track of [this.ego, ...this.cars.values()]) {
      if (!track) continue;
      const pose = track.at(now);
      Object.assign(track, { x: pose.x, y: pose.y, heading: pose.heading, turnRate: 0, acceleration: 0 });
      track.offset = { x: 0, y: 0, heading: 0 };
    }
  }
}

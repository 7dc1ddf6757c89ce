// The frames of the last minute, and which of them is shown.

const KEPT = 460;

export class Store {
  constructor(most = KEPT) {
    this.most = most;
    this.frames = [];
    this.index = new Map();
    this.times = new Map();
    /** Place of the frame that is shown; null follows the newest. */
    this.chosen = null;
    this.reports = {};
  }

  take(frame) {
    if (frame.reports) this.reports = frame.reports;
    const key = `${frame.e}.${frame.k}`;
    const known = this.index.get(key);
    if (known !== undefined) {
      Object.assign(known, frame);
      return;
    }
    const last = this.frames.at(-1);
    const isOlder = last && (frame.e < last.e || (frame.e === last.e && frame.k < last.k));
    if (isOlder) {
      const place = this.frames.findIndex(({ e, k }) => e > frame.e || (e === frame.e && k > frame.k));
      this.frames.splice(place, 0, frame);
      if (this.chosen !== null && place <= this.chosen) this.chosen += 1;
    } else {
      this.frames.push(frame);
    }
    this.index.set(key, frame);
    if (this.frames.length > this.most) {
      const gone = this.frames.shift();
      this.index.delete(`${gone.e}.${gone.k}`);
      if (this.chosen !== null) this.chosen = Math.max(0, this.chosen - 1);
    }
  }

  /** The frame that is shown. */
  get current() {
    return this.frames[this.place] ?? null;
  }

  /** Its place: of the newest that was displayed to the person, where none was chosen. */
  get place() {
    if (this.chosen !== null) return this.chosen;
    const last = this.frames.length - 1;
    const isComplete = ({ display, outcome }) => display || outcome?.end;
    return last > 0 && !isComplete(this.frames[last]) ? last - 1 : last;
  }

  /** Frames of the same episode up to the one that is shown. */
  before(frame) {
    const end = this.frames.indexOf(frame);
    const episode = [];
    for (let i = end; i >= 0 && this.frames[i].e === frame.e; i--) if (this.frames[i].scene) episode.unshift(this.frames[i]);
    return episode;
  }

  choose(place) {
    this.chosen = place === null || place >= this.frames.length - 1 ? null : Math.max(0, place);
  }
}

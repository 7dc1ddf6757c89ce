// The sentences: recorded, decoded when the page opens, and played with the time of their onset measured.

/** Sentences of gridworld driving are put together from their parts. */
const PARTS = /^(Car [a-z]+ [a-z]+:) (\d+ ahead,|\d+ behind,|alongside,) (falls back\.|gains\.|keeps its distance\.)$/;

export class Sound {
  constructor() {
    this.isOn = true;
    this.clips = new Map();
    this.queueEnd = 0;
  }

  /** Sound needs a gesture of the person; call this from one. */
  async unlock() {
    this.context ??= new AudioContext({ latencyHint: "interactive" });
    // Not awaited: a browser that allows no sound yet answers when it does.
    if (this.context.state !== "running") this.context.resume().catch(() => {});
    this.loading ??= this.load();
    await this.loading;
  }

  async load() {
    try {
      const [list, bytes] = await Promise.all([
        fetch("sentences.json").then((answer) => answer.json()),
        fetch("sentences.bin").then((answer) => answer.arrayBuffer()),
      ]);
      await Promise.all(
        Object.entries(list).map(async ([text, [start, length]]) => {
          this.clips.set(text, await this.context.decodeAudioData(bytes.slice(start, start + length)));
        }),
      );
    } catch (error) {
      console.warn("no sentences:", error);
    }
  }

  clipsOf(text) {
    const whole = this.clips.get(text);
    if (whole) return [whole];
    const parts = PARTS.exec(text)?.slice(1).map((part) => this.clips.get(part));
    return parts?.every(Boolean) ? parts : [];
  }

  /** Whether sentences can be heard now. */
  get isReady() {
    return this.isOn && this.context?.state === "running" && this.clips.size > 0;
  }

  /** Plays a sentence; the moment (of performance.now) at which it begins to be heard, or null if it is not. */
  play(text) {
    const clips = this.isReady ? this.clipsOf(text) : [];
    if (!clips.length) return null;
    const { context } = this;
    // What is still being said is not talked over.
    let start = Math.max(context.currentTime + 0.005, this.queueEnd);
    const onset = start;
    for (const clip of clips) {
      const source = new AudioBufferSourceNode(context, { buffer: clip });
      source.connect(context.destination);
      source.start(start);
      start += clip.duration;
    }
    this.queueEnd = start;
    const late = context.outputLatency || context.baseLatency || 0;
    return performance.now() + (onset - context.currentTime + late) * 1000;
  }
}

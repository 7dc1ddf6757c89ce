// The page's line to the process: JSON both ways, opened again whenever it breaks.

const FIRST_MS = 250;
const LONGEST_MS = 4000;

export class Line {
  /** `hear(message, arrived)` gets what comes, `change(isOpen)` is told when the line opens and breaks. */
  constructor(hear, change) {
    this.hear = hear;
    this.change = change;
    this.wait = FIRST_MS;
    this.isOver = false;
    this.open();
  }

  open() {
    const url = new URL("socket", window.location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = url.hash = "";
    this.socket = new WebSocket(url);
    this.socket.onopen = () => {
      this.wait = FIRST_MS;
      this.change(true);
    };
    this.socket.onmessage = (event) => this.hear(JSON.parse(event.data), performance.now());
    this.socket.onclose = () => {
      this.change(false);
      if (this.isOver) return;
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_MS);
    };
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  say(message) {
    // What waits to go out is old by the time it goes.
    if (this.isOpen && this.socket.bufferedAmount < 1 << 16) this.socket.send(JSON.stringify(message));
  }

  /** For good. */
  close() {
    this.isOver = true;
    this.socket.close();
  }
}

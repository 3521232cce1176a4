// The WebSocket, opened again for ever when it is lost.

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5000;
/// The service says something every two seconds; without a word for so long the link is dead.
const SILENCE_MS = 6000;

export class Connection {
  /// `on` has open(), text(object), binary(buffer) and lost(sentence).
  constructor(on) {
    this.on = on;
    this.waitMs = FIRST_WAIT_MS;
    this.heardAt = 0;
    this.isOpen = false;
    setInterval(() => this.#checkSilence(), 1000);
    addEventListener("online", () => this.#open());
    this.#open();
  }

  send(text) {
    if (this.isOpen) this.socket.send(text);
  }

  #open() {
    clearTimeout(this.timer);
    this.#drop();
    const url = new URL("live", document.baseURI);
    url.protocol = url.protocol.replace("http", "ws");
    url.hash = "";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heardAt = performance.now();
    socket.onopen = () => {
      this.isOpen = true;
      this.waitMs = FIRST_WAIT_MS;
      this.on.open();
    };
    socket.onmessage = ({ data }) => {
      this.heardAt = performance.now();
      if (typeof data === "string") this.on.text(JSON.parse(data));
      else this.on.binary(data);
    };
    socket.onclose = () => this.#lost("the service does not answer");
  }

  #drop() {
    if (!this.socket) return;
    this.socket.onclose = null;
    this.socket.onmessage = null;
    this.socket.close();
    this.isOpen = false;
  }

  #lost(why) {
    this.isOpen = false;
    this.on.lost(why, this.waitMs / 1000);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#open(), this.waitMs);
    this.waitMs = Math.min(LONGEST_WAIT_MS, this.waitMs * 1.6);
  }

  #checkSilence() {
    if (this.isOpen && performance.now() - this.heardAt > SILENCE_MS) {
      this.#drop();
      this.#lost("nothing was heard of the service for 6 s");
    }
  }
}

// Panels beside the map: what the service says of itself, recordings and downloads.

import { shown } from "./math.js";
import { duration, told } from "./notices.js";

const $ = (id) => document.getElementById(id);
const TOKEN_KEY = "echosplat-token";

const bytes = (n) => {
  if (!(n >= 0)) return "–";
  const units = ["B", "kB", "MB", "GB", "TB"];
  let unit = 0;
  let value = n;
  while (value >= 1000 && unit < units.length - 1) [value, unit] = [value / 1000, unit + 1];
  return `${unit ? value.toFixed(value < 10 ? 1 : 0) : value} ${units[unit]}`;
};

/// Replaces the children of a list of terms; rows are [term, text, class].
function terms(list, rows) {
  list.replaceChildren(...rows.flatMap(([term, text, kind]) => {
    const dt = document.createElement("dt");
    if (term instanceof Node) dt.append(term);
    else dt.textContent = term;
    const dd = document.createElement("dd");
    dd.textContent = text;
    if (kind) dd.className = kind;
    return [dt, dd];
  }));
}

const LEDGER = [
  ["mapped", "in the map", "#2bb07f"],
  ["held_out", "kept from it to judge it", "#5a6bb0"],
  ["waiting", "wait for a pose", "#2f6fd0"],
  ["queued", "queued", "#5cc8da"],
  ["without_pose", "without a pose", "#e3b23c"],
  ["shed", "dropped", "#d6455f"],
  ["rejected", "rejected", "#e8733c"],
  ["repeated", "came twice", "#a08c5b"],
  ["not_wanted", "not asked for", "#8fa5b5"],
];
const PHASES = { running: "mapping", input_ended: "input ended", finishing: "finishing" };
const LINKS = { waiting: "waiting", up: "up", lost: "lost" };

export class Panels {
  constructor() {
    this.needsToken = false;
    this.isRecording = false;
    $("panels-toggle").addEventListener("click", () => this.toggle());
    $("record").addEventListener("click", () => this.#record());
    $("hold").addEventListener("click", () => this.#hold());
    $("all-filter").addEventListener("input", () => this.#showAll());
    $("panel-all").addEventListener("toggle", () => this.#showAll());
    $("panel-files").addEventListener("toggle", () => this.#refreshLogs());
    $("token-form").addEventListener("submit", (event) => {
      event.preventDefault();
      sessionStorage.setItem(TOKEN_KEY, $("token").value);
      $("token-form").hidden = true;
      (this.afterToken ?? (() => this.#record()))();
    });
    // The address in the service's log bears the token; it stays out of the history.
    const given = new URLSearchParams(location.hash.slice(1)).get("token");
    if (given) {
      sessionStorage.setItem(TOKEN_KEY, given);
      history.replaceState(null, "", location.pathname + location.search);
    }
  }

  toggle(isOpen = !document.body.classList.contains("shows-panels")) {
    document.body.classList.toggle("shows-panels", isOpen);
    $("panels-toggle").setAttribute("aria-expanded", isOpen);
  }

  hello(hello) {
    this.needsToken = hello.needs_token;
    $("node").textContent = hello.node;
    document.title = `${hello.node} – EchoSplat`;
    this.#refreshLogs();
  }

  connected(isConnected, why, waitS) {
    pill("link", isConnected ? "up" : "lost", isConnected ? "connected" : "not connected");
    $("lost").hidden = isConnected;
    if (isConnected) return;
    const again = waitS ? ` Tried again in ${waitS.toFixed(0) || 1} s.` : "";
    $("lost").querySelector("span").textContent = `${why}. What you see is from before.${again}`;
  }

  status(status) {
    this.newest = status;
    const { link, rates, ledger, mapper, poses, latency_s: latency, recording } = status;
    const source = poses?.source ?? {};
    const senders = source.senders ?? [];
    const named = (sender) => sender.kind ? `${sender.name} (${sender.kind})` : sender.name;
    const isDone = status.final;
    pill("sonar", isDone ? "off" : link.state, isDone ? "dive ended" : `sonar ${LINKS[link.state] ?? link.state}`);
    this.#setRecording(Boolean(recording) && !isDone, recording?.bytes);
    this.#setHeld(isDone ? null : status.replay_is_held);
    terms2($("figures"), [
      ["pings/s", shown(rates.pings_per_s, 1)],
      ["Gaussians", shown(mapper.confident)],
      ["poses/s", shown(source.rate_hz, 1)],
      ["left out", shown(status.pings_left_out)],
      ["dive", duration(status.dive_s)],
    ]);
    const rows = [
      ["Phase", isDone ? "ended" : PHASES[status.phase] ?? status.phase],
      ["Sonar", [LINKS[link.state] ?? link.state, link.device].filter(Boolean).join(", "), link.state === "lost" ? "bad" : ""],
    ];
    if (link.losses) rows.push(["Link lost", `${link.losses === 1 ? "once" : `${link.losses} times`}${link.last_reason ? `: ${link.last_reason}` : ""}`, "warn"]);
    if (link.configured !== null) rows.push(["Settings confirmed", link.configured ? "yes" : "not yet"]);
    if (status.input_share !== null) rows.push(["Log read", `${(100 * status.input_share).toFixed(0)} %`]);
    rows.push(
      ["Pings received", `${shown(status.pings_received)}, ${shown(rates.pings_per_s, 1)}/s`],
      ["Pings mapped", `${shown(status.pings_mapped)}, ${shown(rates.mapped_per_s, 1)}/s`],
      ["Received", `${bytes(rates.bytes_per_s)}/s`],
      ["Damaged", `${shown(status.sonar.session.frames_bad)} frames, ${bytes(status.sonar.session.bytes_skipped)}`,
        status.sonar.session.frames_bad ? "warn" : ""],
      ["Poses from", [source.source, ...senders.filter((s) => s.is_used).map(named)].filter(Boolean).join(", ") || "–"],
      ["Poses", `${shown(source.accepted)}, ${shown(source.rate_hz, 1)}/s`],
    );
    const others = senders.filter((s) => !s.is_used && s.age_s < 10).map(named);
    if (others.length) rows.push(["Also heard", others.join(", ")]);
    if (source.age_s !== null && source.age_s !== undefined) rows.push(["Newest pose", `${shown(source.age_s, 2)} s ago`]);
    rows.push(
      ["Ping to map", latency?.measured ? `${shown(latency.p50, 2)} s, 99 %: ${shown(latency.p99, 2)} s` : "–"],
      ["Gaussians", `${shown(mapper.confident)} asserted, ${shown(mapper.ambiguous)} ambiguous`],
      ["Tiles at work", shown(mapper.tiles_at_work)],
    );
    if (status.prediction) rows.push(["Foretells pings", `${status.prediction.gain_per_bin.toFixed(4)} nats/bin`]);
    rows.push(["Memory", `${bytes(status.memory_bytes)}, most ${bytes(status.peak_memory_bytes)}`]);
    if (recording) rows.push(["Recorded", `${bytes(recording.bytes)}, ${shown(recording.lost_messages)} lost`, recording.lost_messages ? "bad" : ""]);
    if (status.left_out?.length) rows.push(["Not needed here", status.left_out.map((p) => `${p.part}: ${p.why}`).join("; ")]);
    terms($("status"), rows);
    this.#ledger(ledger);
    this.#notices(status);
    this.#showAll();
  }

  #ledger(ledger) {
    const rows = LEDGER.filter(([key]) => ledger[key] > 0);
    $("ledger-bar").replaceChildren(...rows.map(([key, , color]) => {
      const part = document.createElement("i");
      part.style.flex = ledger[key];
      part.style.background = color;
      return part;
    }));
    terms($("ledger"), rows.map(([key, name, color]) => {
      const term = document.createElement("span");
      const mark = document.createElement("i");
      mark.style.background = color;
      term.append(mark, name);
      return [term, shown(ledger[key])];
    }));
    for (const mark of $("ledger").querySelectorAll("dt i")) mark.parentNode.before(mark);
  }

  /// Every sentence of the status: what is wrong now first, then what was.
  #notices(status) {
    const { now, over, above } = told(status);
    const item = (kind, text, fine) => {
      const li = Object.assign(document.createElement("li"), { className: kind });
      li.append(text);
      if (fine) li.append(Object.assign(document.createElement("small"), { textContent: fine }));
      return li;
    };
    $("notices").replaceChildren(
      ...(above ? [item("fine", above)] : []),
      ...now.map(({ text, isLoss, fine }) => item(isLoss ? "loss" : "", text, fine)),
      ...over.map(({ text, fine }) => item("over", text, fine)),
    );
    const standing = $("standing");
    const first = status.final ? null : now[0];
    standing.hidden = !first;
    if (first) standing.textContent = now.length > 1 ? `${first.text} (and ${now.length - 1} more)` : first.text;
  }

  #showAll() {
    if (!$("panel-all").open || !this.newest) return;
    const wanted = $("all-filter").value.trim().toLowerCase();
    const rows = [];
    const walk = (value, path) => {
      if (value !== null && typeof value === "object") {
        for (const [key, inner] of Object.entries(value)) walk(inner, path ? `${path}.${key}` : key);
      } else if (path.toLowerCase().includes(wanted)) {
        rows.push([path, typeof value === "number" ? shown(value) : String(value ?? "–")]);
      }
    };
    walk(this.newest, "");
    terms($("all"), rows);
  }

  #setRecording(isOn, size) {
    const changed = isOn !== this.isRecording;
    this.isRecording = isOn;
    pill("recording", isOn ? "on" : "off", `recording ${bytes(size)}`);
    $("recording").hidden = !isOn;
    $("record").textContent = isOn ? "Stop recording" : "Start recording";
    $("record").dataset.on = isOn;
    if (changed) this.#refreshLogs();
  }

  /// Whether a replay is held; null where nothing is replayed.
  #setHeld(isHeld) {
    this.isHeld = isHeld === true;
    $("hold").hidden = isHeld === null || isHeld === undefined;
    $("hold").textContent = this.isHeld ? "Go on" : "Hold replay";
    $("hold").setAttribute("aria-pressed", this.isHeld);
  }

  #hold() {
    return this.#ask($("hold"), `replay/${this.isHeld ? "resume" : "pause"}`, () => this.#hold(), (answer) => {
      this.#setHeld(answer.is_held);
      this.#say(answer.is_held ? "The replay is held." : "The replay goes on.");
    });
  }

  async #record() {
    await this.#ask($("record"), `recording/${this.isRecording ? "stop" : "start"}`, () => this.#record(), (answer) => {
      this.#setRecording(answer.is_recording, 0);
      this.#say(answer.is_recording ? "Recording." : "The recording is complete.");
    });
    this.#refreshLogs();
  }

  /// Has something done, with the token where one is needed; `again` once it is given.
  async #ask(button, path, again, done) {
    const token = sessionStorage.getItem(TOKEN_KEY);
    if (this.needsToken && !token) {
      this.#askForToken(again);
      return;
    }
    button.disabled = true;
    try {
      const headers = token ? { "X-EchoSplat-Token": token } : {};
      const response = await fetch(path, { method: "POST", headers });
      const answer = await response.json().catch(() => ({}));
      if (response.status === 401) {
        sessionStorage.removeItem(TOKEN_KEY);
        this.#askForToken(again);
      }
      if (!response.ok) throw new Error(answer.error ?? `the service answers ${response.status}`);
      done(answer);
    } catch (error) {
      this.#say(error.message, true);
    }
    button.disabled = false;
  }

  #askForToken(again) {
    this.afterToken = again;
    this.toggle(true);
    $("panel-files").open = true;
    $("token-form").hidden = false;
    $("token").focus();
  }

  #say(text, isBad = false) {
    $("file-says").textContent = text;
    $("file-says").classList.toggle("bad", isBad);
  }

  async #refreshLogs() {
    if (!$("panel-files").open) return;
    try {
      const { logs } = await (await fetch("logs")).json();
      $("logs").replaceChildren(...logs.map((log) => {
        const item = document.createElement("li");
        const link = Object.assign(document.createElement("a"), { href: `logs/${log.name}`, textContent: log.name, download: log.name });
        const size = Object.assign(document.createElement("span"), { textContent: bytes(log.bytes) });
        item.append(link, size);
        return item;
      }));
    } catch {
      // The notice of the lost connection says it.
    }
  }
}

function pill(id, state, text) {
  $(id).dataset.state = state;
  $(id).querySelector("span").textContent = text;
}

/// Rows in pairs, each in a box of its own.
function terms2(list, rows) {
  list.replaceChildren(...rows.map(([term, text]) => {
    const box = document.createElement("div");
    box.append(
      Object.assign(document.createElement("dt"), { textContent: term }),
      Object.assign(document.createElement("dd"), { textContent: text }),
    );
    return box;
  }));
}

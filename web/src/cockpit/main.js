// The cockpit: the page at which a person drives.

import { $, make, setText, show } from "../shared/dom.js";
import { Line } from "../shared/socket.js";
import { Board } from "./board.js";
import { openCalibration } from "./calibration.js";
import { Dash } from "./dash.js";
import { Driver } from "./input.js";
import { Sound } from "./sound.js";
import { Tracks } from "./tracks.js";
import { World } from "./world.js";

/** The process is told at least so often that somebody is there. */
const HEARTBEAT_MS = 80;
const CAPTION_MS = 3600;

const ENDS = {
  goal: ["Round complete", "You have reached the end of the road."],
  collision: ["Collision", "The round ends here."],
  time: ["Time is up", "The round ends here."],
  voided: ["Round void", "Nobody was at the wheel for too long. This round does not count."],
};

const page = {
  scene: null,
  episodes: 0,
  voidAfter: 0,
  /** The episode that waits for the person, or is being driven. */
  episode: null,
  /** The episode that the person drives, as the process says, and the one that they want to drive. */
  ready: null,
  wants: null,
  /** The episode that ended last. */
  ended: null,
  presence: "absent",
  isOpen: false,
  isReplaced: false,
  isOver: false,
  /** How the last round ended. */
  end: null,
  captions: false,
  motion: null,
  display: null,
  heard: [],
};

const sound = new Sound();
let tracks = new Tracks();
let world = null;
let board = null;
let driver = null;
let dash = null;
let line = null;
let lastFrame = 0;
let sent = { throttle: 0, steer: 0, at: 0 };

const number = (value) => Math.round(value * 1000) / 1000;

function hear(message, now) {
  switch (message.t) {
    case "hello":
      return begin(message);
    case "round":
      if (page.episode !== message.episode) page.motion = null;
      page.episode = message.episode;
      page.display = null;
      world?.boxes.clear();
      // A line that broke in the middle of a round goes on with it.
      if (page.wants === message.episode && !document.hidden) line.say({ t: "ready", episode: page.episode });
      return update();
    case "motion":
      page.motion = { n: message.n, step: message.k, at: now };
      tracks.take(message, now);
      return undefined;
    case "step":
      return board?.show(message);
    case "display":
      if (world) world.boxes = new Set(message.boxes);
      page.display = { step: message.step, at: now, isSeen: false };
      return undefined;
    case "say":
      return say(message, now);
    case "presence":
      page.presence = message.presence;
      // The process says who is at the wheel: also of a page that has just come back.
      page.ready = page.presence === "present" ? page.episode : null;
      if (page.presence !== "present") tracks.freeze(now);
      return update();
    case "end":
      [page.end, page.ended] = [message.end, message.episode];
      page.ready = null;
      return update();
    case "pong":
      page.answered = message.at;
      return undefined;
    case "replaced":
      page.isReplaced = true;
      line.close();
      return update();
    case "over":
      page.isOver = true;
      line.close();
      return update();
    default:
      return undefined;
  }
}

function begin(hello) {
  page.episodes = hello.episodes;
  page.voidAfter = hello.void_after_s;
  // The same page after a line that broke: everything stands already.
  if (page.scene) return;
  page.scene = hello.scene;
  document.title = `MIRROR · ${hello.scene.name}`;
  if (hello.scene.domain === "highway") {
    for (const id of ["world", "hud", "vignette", "mirror-frame", "dash"]) show($(id), true);
    driver = new Driver(hello.scene.ego);
    dash = new Dash($("dash"), hello.scene.ego.throttle_limit_kmh);
    try {
      world = new World(hello.scene, $("world"), $("hud"), $("mirror-frame"));
    } catch (error) {
      page.trouble = `This browser draws no 3D view (${error.message}).`;
    }
    requestAnimationFrame(frame);
    setInterval(sendInput, HEARTBEAT_MS);
  } else {
    document.body.classList.add("board");
    show($("board"), true);
    board = new Board(hello.scene, (choice, { episode, step }) => line.say({ t: "choice", choice, episode, step }));
    setInterval(() => line.say({ t: "ping", at: performance.now() }), 500);
  }
  update();
}

function say({ id, text }, now) {
  const onset = sound.play(text);
  page.heard.push({ id, text, isHeard: onset !== null });
  if (onset === null) line.say({ t: "unheard", id });
  else line.say({ t: "heard", id, after_ms: number(Math.max(0, onset - now)) });
  // Who cannot hear it reads it.
  if (!page.captions && onset !== null) return;
  setText($("caption"), text);
  show($("caption"), true);
  clearTimeout(page.captionTimer);
  page.captionTimer = setTimeout(() => show($("caption"), false), CAPTION_MS);
}

function frame(now) {
  requestAnimationFrame(frame);
  const elapsed = Math.min(0.1, (now - lastFrame) / 1000);
  lastFrame = now;
  const time = performance.now();
  if (isDriving()) driver.update(elapsed, tracks.ego?.speed ?? 0);
  else [driver.throttle, driver.steer] = [0, 0];
  const differs = Math.abs(driver.throttle - sent.throttle) + Math.abs(driver.steer - sent.steer) > 0.004;
  if (differs) sendInput();
  world?.keepUp(elapsed);
  world?.draw(tracks, time, driver.steer);
  if (tracks.ego) dash.show(tracks.ego.speed);
  if (page.motion) page.drawn = page.motion;
  if (page.display && !page.display.isSeen) {
    page.display.isSeen = true;
    line.say({ t: "seen", step: page.display.step, after_ms: number(time - page.display.at) });
  }
}

function sendInput() {
  if (document.hidden || !line.isOpen) return;
  const now = performance.now();
  sent = { throttle: driver.throttle, steer: driver.steer, at: now };
  line.say({
    t: "input",
    throttle: number(driver.throttle),
    steer: number(driver.steer),
    drawn: page.drawn?.n ?? 0,
    held_ms: page.drawn ? number(now - page.drawn.at) : 0,
  });
}

const isDriving = () => page.presence === "present" && page.ready === page.episode && $("cover").hidden;

/** Ready for the round, or for going on with it. */
async function start() {
  if (page.episode === null || !page.isOpen || page.isReplaced || page.isOver) return;
  if (page.ended === page.episode) return;
  page.end = null;
  page.wants = page.episode;
  line.say({ t: "ready", episode: page.episode });
  await sound.unlock();
}

function pause() {
  if (page.ready === null || page.isReplaced) return;
  page.ready = page.wants = null;
  line.say({ t: "away" });
  update();
}

const keyRow = (keys, text) => [make("span", {}, ...keys.flatMap((key) => [make("kbd", {}, key), " "])), text];

function controls() {
  if (page.scene?.domain !== "highway") return null;
  return make(
    "div",
    { class: "keys" },
    ...keyRow(["←", "→"], "steer"),
    ...keyRow(["↑"], "throttle"),
    ...keyRow(["↓"], "brake"),
    ...keyRow(["Esc"], "pause"),
    ...keyRow(["C"], "captions on or off"),
  );
}

function cardOf() {
  const round = page.episode === null ? "" : `Round ${page.episode + 1} of ${page.episodes}`;
  if (page.isOver) return [round, "That was the last round", "Thank you. You can close this page.", null];
  if (page.isReplaced) return [round, "Continued in another window", "This page drives no more; the one that was opened last does.", null];
  if (!page.isOpen) return ["", "Connecting …", "The run has ended, or does not answer yet.", null];
  if (!page.scene || page.episode === null) return ["", "One moment …", "The world is being set up.", null];
  if (page.ready === page.episode) return null;
  if (page.ended === page.episode) return [round, ...ENDS[page.end], null];
  if (page.presence === "void") return [round, ...ENDS.voided, null];
  const isPaused = page.began === page.episode;
  if (isPaused) {
    return [round, "Paused", `The world stands still. The round is void after ${page.voidAfter} seconds.`, "Go on"];
  }
  if (page.end !== null) {
    const [title, text] = ENDS[page.end] ?? ["Round over", ""];
    return [`${round} is next`, title, text, "Next round"];
  }
  const fog = page.scene.fog;
  const what =
    page.scene.domain === "highway"
      ? `Follow the road to its end without touching anybody.${fog ? " There is fog. Cars that you cannot see may be boxed on your display, or you may be told of them." : ""}`
      : `Your goal: ${page.scene.goal}. What is dark you cannot see; parts may be shown to you, or you may be told of them.`;
  return [round, "Ready?", what, "Start"];
}

function update() {
  if (page.presence === "present" && page.ready === page.episode) page.began = page.episode;
  const card = cardOf();
  const isDriven = card === null;
  if (page.isCalibrating) return;
  show($("cover"), !isDriven);
  const round = page.episode === null ? "" : `Round ${page.episode + 1} of ${page.episodes}`;
  setText($("corner"), isDriven ? round : "");
  if (isDriven) {
    page.shownCard = null;
    return;
  }
  const [over, title, text] = card;
  const action = page.trouble ? null : card[3];
  const key = card.join("|");
  if (page.shownCard === key) return;
  page.shownCard = key;
  $("card").replaceChildren(
    make("div", { class: "over" }, over),
    make("h1", {}, title),
    make("p", {}, page.trouble ?? text),
    ...(action ? [controls() ?? ""] : []),
    action
      ? make("div", { class: "row" }, make("button", { class: "main", id: "start", onclick: start }, action, " ", make("kbd", {}, "Enter")))
      : "",
  );
}

function setCaptions(isOn) {
  page.captions = isOn;
  $("captions").setAttribute("aria-pressed", isOn);
  if (!isOn) show($("caption"), false);
}

// A button keeps no key: space is the brake.
for (const button of document.querySelectorAll("#tools button")) button.addEventListener("click", () => button.blur());
$("captions").onclick = () => setCaptions(!page.captions);
$("sound").onclick = () => {
  sound.isOn = !sound.isOn;
  $("sound").setAttribute("aria-pressed", sound.isOn);
};
$("controls").onclick = () => {
  if (!driver || page.isCalibrating) return;
  pause();
  page.isCalibrating = true;
  show($("cover"), true);
  openCalibration($("card"), driver, () => {
    page.isCalibrating = false;
    page.shownCard = null;
    update();
  });
};

addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.metaKey || page.isCalibrating) return;
  if (event.code === "Enter" && !$("cover").hidden && !(event.target instanceof HTMLButtonElement)) start();
  else if (event.code === "Escape") pause();
  else if (event.code === "KeyC") setCaptions(!page.captions);
  else if (event.code === "KeyM") $("sound").click();
});
document.addEventListener("visibilitychange", () => {
  if (document.hidden) pause();
});
addEventListener("pagehide", () => line.close());

line = new Line(hear, (isOpen) => {
  page.isOpen = isOpen;
  if (!isOpen) tracks.freeze(performance.now());
  update();
});
update();

// For tests, and for whoever looks for the cause of something.
window.mirror = {
  page,
  tracks,
  sound,
  get world() {
    return world;
  },
  get driver() {
    return driver;
  },
  get board() {
    return board;
  },
  ping() {
    page.pinged = performance.now();
    line.say({ t: "ping", at: page.pinged });
  },
};

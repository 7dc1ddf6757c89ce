// The live view: a run, watched.

import { $, make, setText } from "../shared/dom.js";
import { Line } from "../shared/socket.js";
import { drawVisual } from "./boards.js";
import { BAD, LINE, PERSON, PROCESSES, RAISED, ROBOT, SAID, SELF, SOFT, TEXT, alpha, open } from "./colours.js";
import { LAYERS, RoadMap } from "./map.js";
import { drawPolar } from "./polar.js";
import { Store } from "./store.js";

const REASONS = ["planned", "no planner", "the human model gave no answer", "planned, but late"];
const ENDS = ["", "goal reached", "collision", "out of time", "void"];
/** How long a sentence stays in the picture, in steps of the highway. */
const SPOKEN_STEPS = 24;

let store = new Store();
/** Frames of a recording that have been asked for. */
let asked = 0;
let playing = null;
let hello = null;
let map = null;
let parts = null;
let isDirty = true;
let isOver = false;

function hear(message) {
  if (message.t === "hello") begin(message);
  else if (message.t === "frame") {
    store.take(message);
    askForMore();
  }
  else if (message.t === "over") {
    isOver = true;
    line.close();
    state(false);
  }
  isDirty = true;
}

const isHighway = () => hello?.stage.domain === "highway";

function begin(message) {
  const isNew = hello?.run !== message.run;
  hello = message;
  state(true);
  const { about, stage } = hello;
  document.title = `MIRROR · ${stage.name}`;
  setText($("about"), `${stage.name} · driver ${about.driver} · human model ${about.human} · planner ${about.planner}`);
  if (!isNew && parts) return;
  store = new Store(hello.recorded);
  asked = 0;
  askForMore();
  $("panels").replaceChildren();
  parts = isHighway() ? highwayPanels() : gridworldPanels();
  if (isHighway()) {
    map = new RoadMap($("map"), stage);
    map.sight = hello.sight;
    map.redraw = () => (isDirty = true);
    $("legend").replaceChildren(...LAYERS.filter(isOffered).map(legendEntry));
  } else {
    map = null;
    $("legend").replaceChildren();
  }
}

const isOffered = ([name]) =>
  (name !== "fog" || hello.stage.visible_m) && (name !== "sight" || hello.sight);

/** A recording comes in pieces. */
function askForMore() {
  if (!hello?.recorded || store.frames.length < asked || asked >= hello.recorded) return;
  line.say({ from: asked });
  asked = Math.min(asked + 100, hello.recorded);
  if (!store.chosen) store.choose(0);
}

/** Plays a recording at its own pace, or stops. */
function play() {
  if (playing !== null) {
    clearInterval(playing);
    playing = null;
  } else {
    if (store.chosen === null) store.choose(0);
    playing = setInterval(() => {
      if (store.chosen === null) play();
      else store.choose(store.chosen + 1);
      isDirty = true;
    }, 1000 * hello.stage.step_s);
  }
  isDirty = true;
}

function legendEntry([name, label, colour, kind]) {
  const button = make("button", { "aria-pressed": String(map.shown.has(name)) });
  const drawings = {
    line: `<path d="M1 6 H21" stroke="${colour}" stroke-width="2.4"/>`,
    dash: `<path d="M1 6 H21" stroke="${colour}" stroke-width="2" stroke-dasharray="4 3"/>`,
    fill: `<rect x="2" y="1.5" width="18" height="9" rx="2" fill="${colour}" fill-opacity=".22" stroke="${colour}"/>`,
    dots: `<circle cx="4" cy="6" r="3" fill="#5b7a99"/><circle cx="11" cy="6" r="3" fill="#86a9c9"/><circle cx="18" cy="6" r="3" fill="#c5dcee"/>`,
  };
  button.innerHTML = `<svg viewBox="0 0 22 12" aria-hidden="true">${drawings[kind]}</svg>`;
  button.append(label);
  button.onclick = () => {
    const isShown = !map.shown.has(name);
    if (isShown) map.shown.add(name);
    else map.shown.delete(name);
    button.setAttribute("aria-pressed", isShown);
    isDirty = true;
  };
  return button;
}

function panel(title, ...children) {
  const more = make("span");
  const section = make("section", {}, make("h2", {}, title, more), ...children);
  $("panels").append(section);
  return { section, more };
}

function beliefPanel() {
  const canvases = [make("canvas"), make("canvas")];
  const labels = [make("figcaption"), make("figcaption")];
  panel(
    "What is believed to be around",
    make("div", { class: "pair" }, ...canvases.map((canvas, i) => make("figure", {}, canvas, labels[i]))),
  );
  return { canvases, labels };
}

function decisionPanel() {
  const numbers = make("dl");
  const items = make("div", { class: "items" });
  const { more } = panel("What the planner decided", numbers, items);
  return { numbers, items, more };
}

function personPanel() {
  const list = make("dl");
  const { more } = panel("What the person does", list);
  return { list, more };
}

function timesPanel() {
  const rows = Object.fromEntries(
    Object.keys(PROCESSES).map((name) => [name, { canvas: make("canvas"), value: make("output") }]),
  );
  const { more } = panel(
    "Computing time",
    make("div", { class: "times" }, ...Object.entries(rows).flatMap(([name, { canvas, value }]) => [name, canvas, value])),
  );
  return { rows, more };
}

const highwayPanels = () => ({
  belief: beliefPanel(),
  decision: decisionPanel(),
  person: personPanel(),
  times: timesPanel(),
});
const gridworldPanels = highwayPanels;

function draw() {
  requestAnimationFrame(draw);
  if (!isDirty || !parts) return;
  isDirty = false;
  const frame = store.current;
  if (!frame) return;
  const before = store.before(frame);
  if (map) map.draw(frame, before);
  else drawBoard(frame);
  drawWords(frame);
  drawBeliefs(frame);
  drawDecision(frame);
  drawBeside(frame);
  drawPerson(frame);
  drawTimes(frame);
  drawTimeline(frame);
}

/** A gridworld's true state: as sensed, in the middle of the stage. */
function drawBoard(frame) {
  const { pen, width, height } = open($("map"));
  const canvas = document.createElement("canvas");
  const wanted = Math.min(width * 0.7, height * 0.72 * (hello.stage.image ? hello.stage.image[2] / hello.stage.image[1] : 4));
  canvas.style.cssText = `position:fixed;left:-9999px;width:${wanted}px`;
  document.body.append(canvas);
  drawVisual(canvas, frame.sensed?.visual, hello.stage, SOFT);
  const box = canvas.getBoundingClientRect();
  if (canvas.width) pen.drawImage(canvas, (width - box.width) / 2, (height - box.height) / 2, box.width, box.height);
  canvas.remove();
}

function drawWords(frame) {
  const place = store.frames.indexOf(frame);
  const most = isHighway() ? SPOKEN_STEPS : 1;
  let said = [];
  for (let i = place; i >= 0 && i > place - most && !said.length; i--) {
    if (store.frames[i].e === frame.e) said = store.frames[i].display?.said ?? [];
  }
  const end = ENDS[frame.outcome?.end ?? 0];
  const words = $("words");
  words.replaceChildren(
    ...said.map(({ text }) => make("div", {}, `“${text}”`)),
    ...(end ? [make("div", { style: `color:${frame.outcome.end === 2 ? BAD : TEXT}` }, end[0].toUpperCase() + end.slice(1))] : []),
  );
}

function drawBeliefs(frame) {
  const { canvases, labels } = parts.belief;
  const truth = isHighway() ? frame.lidar : frame.sensed;
  const about = [
    ["Robot", frame.robot, ROBOT],
    ["Person", frame.human, PERSON],
  ];
  about.forEach(([name, belief, colour], i) => {
    if (isHighway()) drawPolar(canvases[i], belief, truth, colour);
    else drawVisual(canvases[i], belief?.visual, hello.stage, colour);
    const unsure = belief ? ` · σ ${belief.deviation.toFixed(2)}` : "";
    setText(labels[i], `${name}${unsure}`);
  });
}

const signed = (value) => `${value >= 0 ? "+" : "−"}${Math.abs(value).toFixed(2)}`;

function row(list, name, value, colour) {
  list.append(make("dt", {}, name), make("dd", colour ? { style: `color:${colour}` } : {}, value));
}

function drawDecision(frame) {
  const { numbers, items, more } = parts.decision;
  const { decision } = frame;
  setText(more, decision ? (REASONS[decision.reason] ?? "") : "nothing yet");
  numbers.replaceChildren();
  if (!decision || decision.reason === 1) {
    items.replaceChildren();
    return;
  }
  if (decision.gain_now !== undefined) {
    row(numbers, "Gain of saying it now", signed(decision.gain_now));
    row(numbers, "Gain of saying it later", signed(decision.gain_later));
  } else {
    row(numbers, "Gain over silence", signed(decision.value - decision.value_silent));
    row(numbers, "Value, with and without", `${decision.value.toFixed(1)} · ${decision.value_silent.toFixed(1)}`);
  }
  row(numbers, "Cost", decision.cost.toFixed(2));
  const futures = decision.futures ?? decision.samples;
  if (futures) row(numbers, "Imagined futures", `${futures} × ${decision.iterations}`);
  const { stage } = hello;
  const spoken = stage.utterances ?? stage.items;
  const bar = (probability, isOn, kind) => {
    const share = Math.round(100 * Math.min(1, Math.max(0, probability ?? 0)));
    return make("span", { class: `bar ${kind} ${isOn ? "on" : ""}`, title: `${share} %` }, make("i", { style: `width:${share}%` }));
  };
  const names = isHighway() ? stage.items : [...new Set([...stage.items, ...spoken])];
  const cell = (list, name, probabilities, bits, kind) => {
    const at = list.indexOf(name);
    return at < 0 ? make("span") : bar(probabilities[at], (bits >> at) & 1, kind);
  };
  items.replaceChildren(
    make("span"),
    make("span", { class: "head" }, "highlight"),
    make("span", { class: "head" }, "say"),
    ...names.flatMap((name) => [
      make("span", {}, name),
      cell(stage.items, name, decision.visual_probability, decision.visual, "visual"),
      cell(spoken, name, decision.verbal_probability, decision.verbal, "verbal"),
    ]),
  );
}

/** What is decided now, in words. */
function drawBeside(frame) {
  const { beside } = frame;
  const { about, stage } = hello;
  if (!about.human_now) return;
  const spoken = stage.utterances ?? stage.items;
  const named = (names, bits) => names.filter((_, at) => (bits >> at) & 1).join(", ") || "nothing";
  const { numbers } = parts.decision;
  const now = beside ? [named(stage.items, beside.visual), named(spoken, beside.verbal)] : ["–", "–"];
  row(numbers, `${about.human_now} · ${about.planner_now} would highlight`, now[0]);
  row(numbers, `${about.human_now} · ${about.planner_now} would say`, now[1]);
}

function drawPerson(frame) {
  const { list, more } = parts.person;
  list.replaceChildren();
  const { action, human, cockpit } = frame;
  setText(more, human ? `model ${human.kind}` : "");
  if (isHighway()) {
    const speed = frame.scene?.ego[4];
    if (speed !== undefined) row(list, "Speed", `${Math.round(speed * 3.6)} km/h`);
    const pedal = (value) => (value >= 0 ? `throttle ${value.toFixed(2)}` : `brake ${(-value).toFixed(2)}`);
    const wheel = (value) => (Math.abs(value) < 0.005 ? "straight" : `${value > 0 ? "left" : "right"} ${Math.abs(value).toFixed(2)}`);
    if (action) row(list, "Really", `${pedal(action.throttle)} · ${wheel(action.steer)}`, SELF);
    if (human) row(list, "Expected", `${pedal(human.action[0])} · ${wheel(human.action[1])}`, PERSON);
  } else {
    const { actions } = hello.stage;
    if (action?.choice !== undefined) row(list, "Really", actions[action.choice] ?? "nothing", SELF);
    human?.probability.slice(0, actions.length).forEach((probability, choice) => {
      row(list, `Expected: ${actions[choice]}`, `${Math.round(100 * probability)} %`, PERSON);
    });
  }
  if (human?.log_likelihood) row(list, "Log-likelihood", human.log_likelihood.toFixed(2));
  if (frame.outcome) row(list, "Reward of the step", signed(frame.outcome.reward));
  if (cockpit) {
    row(list, "Input is old", `${cockpit.input_age_ms.toFixed(0)} ms`);
    row(list, "To the page and back", `${cockpit.round_trip_ms.toFixed(0)} ms`);
    if (cockpit.presence !== 1) row(list, "At the wheel", "nobody: the world stands still", BAD);
  }
}

const duration = (us) =>
  us >= 1_000_000 ? `${(us / 1e6).toFixed(1)} s` : (us >= 10_000 ? `${(us / 1000).toFixed(0)} ms` : us >= 1000 ? `${(us / 1000).toFixed(1)} ms` : `${us} µs`);

function drawTimes(frame) {
  const end = store.frames.indexOf(frame);
  const recent = store.frames.slice(Math.max(0, end - 119), end + 1);
  let slowest = 0;
  const computed = (each, name) => each.times?.find(([process]) => process === name)?.[1];
  for (const [name, { canvas, value }] of Object.entries(parts.times.rows)) {
    const { pen, width, height } = open(canvas, 20);
    const values = recent.map((each) => computed(each, name));
    const most = Math.max(1, ...values.filter((value) => value !== undefined));
    slowest = Math.max(slowest, most);
    const step = width / 120;
    pen.fillStyle = LINE;
    pen.fillRect(0, height - 1, width, 1);
    pen.fillStyle = PROCESSES[name];
    values.forEach((value, i) => {
      if (value === undefined) return;
      const high = Math.max(1, (height - 2) * (value / most));
      pen.fillRect(width - (values.length - i) * step, height - 1 - high, Math.max(1, step - 0.6), high);
    });
    const now = values.at(-1) ?? values.at(-2);
    setText(value, now === undefined ? "–" : duration(now));
  }
  const planned = frame.times?.find(([process]) => process === "planner");
  setText(parts.times.more, planned ? `decided ${duration(planned[2])} after sensing` : "");
}

/** What happened when: words, highlights, ends, and the moment that is shown. */
function drawTimeline(frame) {
  const { pen, width, height } = open($("timeline"));
  const { frames } = store;
  const middle = height / 2;
  pen.fillStyle = RAISED;
  pen.beginPath();
  pen.roundRect(0, middle - 3, width, 6, 3);
  pen.fill();
  const most = Math.max(frames.length, 200);
  const at = (i) => width - ((frames.length - 1 - i + 0.5) * width) / most;
  const step = width / most;
  frames.forEach((each, i) => {
    const x = at(i);
    if (each.display?.boxes.length) {
      pen.fillStyle = alpha(PERSON, 0.9);
      pen.fillRect(x - step / 2, middle - 3, step + 0.4, 6);
    }
    if (each.display?.said.length) {
      pen.fillStyle = SAID;
      pen.beginPath();
      pen.arc(x, middle - 11, 3.5, 0, 2 * Math.PI);
      pen.fill();
    }
    if (each.outcome?.end) {
      pen.fillStyle = each.outcome.end === 2 ? BAD : SOFT;
      pen.fillRect(x - 1, 2, 2, height - 4);
    }
  });
  const x = at(frames.indexOf(frame));
  pen.fillStyle = store.chosen === null ? alpha(TEXT, 0.7) : TEXT;
  pen.beginPath();
  pen.roundRect(x - 2, 1, 4, height - 2, 2);
  pen.fill();
  const time = (frame.k * hello.stage.step_s).toFixed(1);
  setText($("when"), `episode ${frame.e} · ${time} s`);
  const isRecording = Boolean(hello.recorded);
  setText($("live"), isRecording ? (playing === null ? "Play" : "Pause") : "Live");
  $("live").classList.toggle("main", isRecording || (store.chosen === null && !isOver));
}

function scrub(event) {
  const box = $("timeline").getBoundingClientRect();
  const most = Math.max(store.frames.length, 200);
  const back = ((box.right - event.clientX) / box.width) * most - 0.5;
  store.choose(Math.round(store.frames.length - 1 - back));
  isDirty = true;
}

$("timeline").onpointerdown = (event) => {
  $("timeline").setPointerCapture(event.pointerId);
  scrub(event);
};
$("timeline").onpointermove = (event) => {
  if (event.buttons & 1) scrub(event);
};
$("live").onclick = () => {
  if (hello?.recorded) play();
  else store.choose(null);
  isDirty = true;
};
addEventListener("keydown", (event) => {
  const by = { ArrowLeft: -1, ArrowRight: 1 }[event.code];
  if (by) {
    event.preventDefault();
    store.choose((store.chosen ?? store.frames.length - 1) + by * (event.shiftKey ? 10 : 1));
  } else if (event.code === "Space" && hello?.recorded && !(event.target instanceof HTMLButtonElement)) {
    event.preventDefault();
    play();
  } else if (event.code === "End" || event.code === "Escape") store.choose(null);
  else return;
  isDirty = true;
});
addEventListener("resize", () => (isDirty = true));

function state(isOpen) {
  $("dot").classList.toggle("off", !isOpen);
  setText($("state"), isOver ? "the run is over" : !isOpen ? "connecting" : hello?.recorded ? "recording" : "live");
}

const line = new Line(hear, state);
requestAnimationFrame(draw);

window.mirror = {
  get store() {
    return store;
  },
  get hello() {
    return hello;
  },
  get map() {
    return map;
  },
};

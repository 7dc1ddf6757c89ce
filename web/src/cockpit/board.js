// The gridworlds: a board, what is seen of it, and a key for every action.

import { $, make } from "../shared/dom.js";
import { kindOf } from "../shared/house.js";

const HIDDEN = "#10141a";
const SEEN = "#1f262f";
const KEYS = {
  up: ["↑", ["ArrowUp", "KeyW"]],
  down: ["↓", ["ArrowDown", "KeyS"]],
  left: ["←", ["ArrowLeft", "KeyA"]],
  right: ["→", ["ArrowRight", "KeyD"]],
  stay: ["↑", ["ArrowUp", "Space", "KeyW"]],
  switch: ["⇄", ["ArrowLeft", "ArrowRight", "KeyA", "KeyD"]],
  "button 1": ["1", ["Digit1", "Numpad1"]],
  "button 2": ["2", ["Digit2", "Numpad2"]],
  "button 3": ["3", ["Digit3", "Numpad3"]],
  wait: ["W", ["Space", "KeyW"]],
};

export class Board {
  constructor(scene, choose) {
    this.scene = scene;
    this.choose = choose;
    this.canvas = $("cells");
    this.step = null;
    if (scene.rules) showRules(scene.rules);
    this.buttons = scene.actions.map((name, choice) => {
      const [label] = KEYS[name] ?? [String(choice + 1)];
      return make(
        "button",
        { onclick: () => this.act(choice), "data-choice": choice },
        make("kbd", {}, label),
        name[0].toUpperCase() + name.slice(1),
      );
    });
    $("choices").replaceChildren(...this.buttons);
    addEventListener("keydown", (event) => {
      if (event.repeat || event.ctrlKey || event.metaKey) return;
      const choice = scene.actions.findIndex((name) => KEYS[name]?.[1].includes(event.code));
      if (choice < 0 || $("board").hidden || !$("cover").hidden) return;
      event.preventDefault();
      this.act(choice);
    });
    new ResizeObserver(() => this.draw()).observe($("board"));
  }

  act(choice) {
    if (this.step && (this.step.shown.legal >> choice) & 1) this.choose(choice, this.step);
  }

  show(step) {
    this.step = step;
    this.buttons.forEach((button, choice) => (button.disabled = !((step.shown.legal >> choice) & 1)));
    this.draw();
  }

  /** The canvas as a grid of so many cells; its pen, in cells. */
  grid(columns, rows) {
    const room = $("board").getBoundingClientRect();
    const beside = this.scene.rules ? $("rules").offsetWidth + 44 : 0;
    const cell = Math.floor(Math.min((room.width - 48 - beside) / columns, (room.height - 190) / rows, 84));
    const ratio = window.devicePixelRatio;
    Object.assign(this.canvas, { width: columns * cell * ratio, height: rows * cell * ratio });
    this.canvas.style.width = `${columns * cell}px`;
    const pen = this.canvas.getContext("2d");
    pen.scale(cell * ratio, cell * ratio);
    return pen;
  }

  draw() {
    if (!this.step) return;
    const draw = { driving: drawDriving, search_rescue: drawRescue, bomb_defusal: drawBomb }[this.scene.domain];
    draw?.(this);
  }
}

function tile(pen, x, y, colour, gap = 0.035) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.roundRect(x + gap, y + gap, 1 - 2 * gap, 1 - 2 * gap, 0.1);
  pen.fill();
}

function outline(pen, x, y, width, height) {
  pen.strokeStyle = "#ffb340";
  pen.lineWidth = 0.06;
  pen.beginPath();
  pen.roundRect(x + 0.06, y + 0.06, width - 0.12, height - 0.12, 0.14);
  pen.stroke();
}

function write(pen, text, x, y, colour, size = 0.36) {
  pen.fillStyle = colour;
  pen.font = `600 ${size}px Inter, sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, x, y);
}

function car(pen, x, y, colour) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.roundRect(x + 0.14, y + 0.22, 0.72, 0.56, 0.16);
  pen.fill();
  pen.fillStyle = "rgb(8 10 13 / 55%)";
  pen.beginPath();
  pen.roundRect(x + 0.5, y + 0.3, 0.16, 0.4, 0.05);
  pen.fill();
}

/** Two lanes, ten cells behind and ten ahead; one drives to the right. */
function drawDriving(board) {
  const pen = board.grid(21, 2);
  const { visual, highlighted } = board.step.shown;
  const lane = visual[0] < 0 ? 0 : 1;
  for (let x = 0; x < 21; x++) for (let y = 0; y < 2; y++) tile(pen, x, y, SEEN);
  car(pen, 10, lane, "#62b5f0");
  visual.slice(1).forEach((position, slot) => {
    const y = slot % 2;
    // Where one does not see, the lane is dark.
    if (position === null) {
      const [from, to] = slot < 2 ? [11, 21] : [0, 10];
      for (let x = from; x < to; x++) {
        const isNear = slot < 2 ? x < 13 : false;
        if (!isNear) tile(pen, x, y, HIDDEN);
      }
      return;
    }
    const x = 10 + Math.round(position * 10);
    car(pen, x, y, "#f2a93b");
    if ((highlighted >> slot) & 1) outline(pen, x, y, 1, 1);
  });
}

/** The house: walls, smoke, the person, the victim. */
function drawRescue(board) {
  const pen = board.grid(9, 9);
  const { visual, highlighted } = board.step.shown;
  const cells = 81;
  const [row, column] = [0, 1].map((i) => Math.round(visual[3 * cells + i] * 4 + 4));
  for (let cell = 0; cell < cells; cell++) {
    const [x, y] = [cell % 9, Math.floor(cell / 9)];
    const colour = [0, 1, 2].map((channel) => visual[channel * cells + cell]);
    if (colour.includes(null)) {
      tile(pen, x, y, HIDDEN);
      write(pen, "·", x + 0.5, y + 0.5, "#333c48", 0.5);
      continue;
    }
    drawCell(pen, x, y, colour);
  }
  for (let portion = 0; portion < 9; portion++) {
    if ((highlighted >> portion) & 1) outline(pen, (portion % 3) * 3, Math.floor(portion / 3) * 3, 3, 3);
  }
  pen.fillStyle = "#62b5f0";
  pen.beginPath();
  pen.arc(column + 0.5, row + 0.5, 0.3, 0, 2 * Math.PI);
  pen.fill();
  if (visual[3 * cells + 2] > 0.5) write(pen, "+", column + 0.5, row + 0.52, "#07131d", 0.44);
}

/** How the live terminal looks, and which button is right where. */
function showRules({ live, buttons }) {
  const glyph = make("canvas", { width: 120, height: 120, style: "width:60px;height:60px" });
  const pen = glyph.getContext("2d");
  pen.scale(24, 24);
  live.forEach((isDrawn, at) => {
    if (isDrawn) tile(pen, at % 5, Math.floor(at / 5), "#e8ebef", 0.06);
  });
  const rows = buttons.map((row, type) => {
    const cells = row.map((button) => make("td", {}, String(button + 1)));
    const half = cells.length / 2;
    return make(
      "div",
      {},
      make("h2", {}, `Type ${"AB"[type]} bomb`),
      make("table", {}, make("tr", {}, ...cells.slice(0, half)), make("tr", {}, ...cells.slice(half))),
    );
  });
  const rules = $("rules");
  rules.replaceChildren(make("h2", {}, "The live terminal shows"), glyph, make("div", {}, "Press the button of its place:"), ...rows);
  rules.hidden = false;
}

function drawCell(pen, x, y, colour) {
  const { name, fill, letter } = kindOf(colour);
  tile(pen, x, y, fill, name === "wall" ? 0 : 0.035);
  if (letter) write(pen, letter, x + 0.5, y + 0.53, "#0d1014", 0.42);
}

/** Six terminals with a glyph each, and the stage. */
function drawBomb(board) {
  const pen = board.grid(17.6, 14);
  pen.translate(0.3, 0.3);
  const { visual, highlighted } = board.step.shown;
  for (let terminal = 0; terminal < 6; terminal++) {
    const [left, top] = [(terminal % 3) * 6, Math.floor(terminal / 3) * 6];
    pen.fillStyle = "#161c23";
    pen.beginPath();
    pen.roundRect(left - 0.1, top - 0.1, 5.2, 5.2, 0.5);
    pen.fill();
    for (let y = 0; y < 5; y++) {
      for (let x = 0; x < 5; x++) {
        const value = visual[(top + y) * 17 + left + x];
        if (value === null) continue;
        if (value > 0.5) tile(pen, left + x, top + y, "#e8ebef", 0.08);
      }
    }
    if (visual[top * 17 + left] === null) write(pen, "?", left + 2.5, top + 2.6, "#4a5563", 2.2);
    if ((highlighted >> terminal) & 1) outline(pen, left - 0.2, top - 0.2, 5.4, 5.4);
  }
  const stage = [0, 1, 2].findIndex((stage) => visual[187 + stage] > 0.5);
  for (let i = 0; i < 3; i++) {
    pen.fillStyle = i < stage ? "#45c9a5" : i === stage ? "#62b5f0" : "#272e38";
    pen.beginPath();
    pen.roundRect(6.1 + 1.7 * i, 12.1, 1.4, 0.5, 0.25);
    pen.fill();
  }
  write(pen, `Stage ${stage + 1} of 3 · ${Math.round(100 * visual[190])} % of the time left`, 8.5, 13.3, "#a3acb9", 0.52);
}

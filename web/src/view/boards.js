// A gridworld's belief or observation as an image or as a row of lanes.

import { kindOf } from "../shared/house.js";
import { FAINT, RAISED, SELF, SOFT, open } from "./colours.js";

/** An image's pixel; a house's in the theme's colours, the paler the less it looks like anything. */
function colourOf(red, green, blue, channels) {
  if (channels !== 3) return `rgb(${byte(red)} ${byte(green)} ${byte(blue)})`;
  const { fill, clarity } = kindOf([red, green, blue]);
  return `color-mix(in srgb, ${fill} ${Math.round(100 * clarity)}%, ${RAISED})`;
}

const byte = (value) => Math.round(255 * Math.min(1, Math.max(0, value)));

/** Draws a visual modality: image first, or driving's lane and positions. */
export function drawVisual(canvas, visual, stage, colour) {
  const side = canvas.getBoundingClientRect().width;
  if (!stage.image) return drawLanes(canvas, visual, colour);
  const [channels, rows, columns] = stage.image;
  const { pen, width } = open(canvas, Math.round((side * rows) / columns));
  const cell = width / columns;
  for (let y = 0; y < rows; y++) {
    for (let x = 0; x < columns; x++) {
      const value = (channel) => visual?.[channel * rows * columns + y * columns + x] ?? 0;
      const [red, green, blue] = channels === 3 ? [0, 1, 2].map(value) : [value(0), value(0), value(0)];
      pen.fillStyle = visual ? colourOf(red, green, blue, channels) : RAISED;
      pen.fillRect(x * cell + 0.5, y * cell + 0.5, cell - 1, cell - 1);
    }
  }
  if (stage.domain === "search_rescue" && visual) {
    const at = (index) => visual[channels * rows * columns + index] * 4 + 4.5;
    pen.fillStyle = SELF;
    pen.beginPath();
    pen.arc(at(1) * cell, at(0) * cell, cell * 0.32, 0, 2 * Math.PI);
    pen.fill();
  }
  if (!visual) nothing(pen, width, (side * rows) / columns);
}

function nothing(pen, width, height) {
  pen.fillStyle = FAINT;
  pen.font = "12px Inter, sans-serif";
  pen.textAlign = "center";
  pen.fillText("not of this kind", width / 2, height / 2);
}

function drawLanes(canvas, visual, colour) {
  const { pen, width, height } = open(canvas, 54);
  const cell = width / 21;
  for (let lane = 0; lane < 2; lane++) {
    pen.fillStyle = RAISED;
    pen.fillRect(0, lane * 26 + 1, width, 22);
  }
  if (!visual) return nothing(pen, width, height);
  const car = (position, lane, fill) => {
    pen.fillStyle = fill;
    pen.beginPath();
    pen.roundRect((10 + position) * cell, lane * 26 + 5, cell * 0.9, 14, 3);
    pen.fill();
  };
  visual.slice(1, 5).forEach((position, slot) => car(position * 10, slot % 2, colour ?? SOFT));
  car(0, visual[0] < 0 ? 0 : 1, SELF);
}

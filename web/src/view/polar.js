// A belief as the car would see it: how far away something is, in every direction, in each of three heights.

import { FAINT, LINE, SELF, SOFT, alpha, open } from "./colours.js";

const AZIMUTHS = 36;
const REACH_M = 40;

/** Draws a belief; `truth` is what is really sensed. */
export function drawPolar(canvas, belief, truth, colour) {
  const side = canvas.getBoundingClientRect().width;
  const { pen, width, height } = open(canvas, Math.round(side));
  const [cx, cy, radius] = [width / 2, height / 2, Math.min(width, height) / 2 - 6];
  const place = (azimuth, metres) => {
    const angle = -Math.PI / 2 - (azimuth * 2 * Math.PI) / AZIMUTHS;
    const far = (radius * Math.sqrt(Math.min(metres, REACH_M) / REACH_M));
    return [cx + far * Math.cos(angle), cy + far * Math.sin(angle)];
  };
  pen.lineWidth = 1;
  for (const metres of [5, 10, 20, 40]) {
    pen.strokeStyle = metres === 40 ? "#333c48" : LINE;
    pen.beginPath();
    pen.arc(cx, cy, radius * Math.sqrt(metres / REACH_M), 0, 2 * Math.PI);
    pen.stroke();
  }
  pen.fillStyle = FAINT;
  pen.font = "10.5px Inter, sans-serif";
  pen.textAlign = "center";
  for (const metres of [5, 20]) pen.fillText(`${metres} m`, cx, cy - radius * Math.sqrt(metres / REACH_M) + 12);
  pen.fillStyle = SELF;
  pen.beginPath();
  pen.roundRect(cx - 3, cy - 6, 6, 12, 2);
  pen.fill();
  if (truth?.range) {
    pen.fillStyle = alpha(SOFT, 0.75);
    for (let azimuth = 0; azimuth < AZIMUTHS; azimuth++) {
      const metres = Math.min(...[0, 1, 2].map((band) => truth.range[band * AZIMUTHS + azimuth] ?? Infinity));
      if (!Number.isFinite(metres)) continue;
      const [x, y] = place(azimuth, metres);
      pen.beginPath();
      pen.arc(x, y, 2.2, 0, 2 * Math.PI);
      pen.fill();
    }
  }
  if (!belief?.range) {
    pen.fillStyle = FAINT;
    pen.font = "12px Inter, sans-serif";
    pen.fillText("not of this kind", cx, cy + radius / 2);
    return;
  }
  const near = Array.from({ length: AZIMUTHS }, (_, azimuth) =>
    Math.min(...[0, 1, 2].map((band) => belief.range[band * AZIMUTHS + azimuth] ?? REACH_M)));
  pen.beginPath();
  near.forEach((metres, azimuth) => {
    const [x, y] = place(azimuth, metres);
    if (azimuth) pen.lineTo(x, y);
    else pen.moveTo(x, y);
  });
  pen.closePath();
  pen.fillStyle = alpha(colour, 0.14);
  pen.strokeStyle = colour;
  pen.lineWidth = 1.6;
  pen.lineJoin = "round";
  pen.fill();
  pen.stroke();
}

// The drive from above, the ego car in the lower middle and its heading up: road, cars with their trails, LIDAR returns by
// height, how far the person really sees and is believed to see.

import { BAD, BANDS, FAINT, PERSON, ROBOT, SELF, SOFT, alpha, open } from "./colours.js";

const AZIMUTHS = 36;
const TRAIL_STEPS = 40;
const NOWHERE = 40;

export const LAYERS = [
  ["trails", "Trails", FAINT, "line"],
  ["lidar", "LIDAR, by height", BANDS[2], "dots"],
  ["fog", "Sight in this fog", SOFT, "dash"],
  ["sight", "Sight as learned", PERSON, "line"],
  ["robot", "Robot believes", ROBOT, "line"],
  ["person", "Person believes", PERSON, "fill"],
];

export class RoadMap {
  constructor(canvas, stage) {
    this.canvas = canvas;
    this.stage = stage;
    this.shown = new Set(["trails", "lidar", "fog", "sight"]);
    this.sight = null;
    this.scale = 9;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.scale = Math.min(30, Math.max(2.5, this.scale * Math.exp(-event.deltaY / 600)));
      this.redraw?.();
    }, { passive: false });
  }

  /** Draws a frame; `before` are the frames of this episode before it. */
  draw(frame, before) {
    const { pen, width, height } = open(this.canvas);
    this.pen = pen;
    if (!frame?.scene) return;
    const [, x, y, heading] = frame.scene.ego;
    this.ego = { x, y, heading };
    pen.save();
    pen.translate(width / 2, height * 0.6);
    pen.scale(this.scale, -this.scale);
    pen.rotate(Math.PI / 2 - heading);
    pen.translate(-x, -y);
    this.drawRoad();
    if (this.shown.has("trails")) this.drawTrails(frame, before);
    this.drawRings(frame);
    if (this.shown.has("lidar") && frame.lidar) this.drawLidar(frame.lidar);
    this.drawCars(frame);
    pen.restore();
    this.drawScale(width, height);
  }

  line(points, close = false) {
    const { pen } = this;
    pen.beginPath();
    points.forEach(([x, y], index) => (index ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    if (close) pen.closePath();
  }

  drawRoad() {
    const { pen } = this;
    const { surface, lines } = this.stage.road;
    this.line([...surface.map(([left]) => left), ...surface.map(([, right]) => right).reverse()], true);
    pen.fillStyle = "#191e25";
    pen.fill();
    for (const { points, dashed } of lines) {
      pen.strokeStyle = dashed ? "#4b5563" : "#626d7b";
      pen.lineWidth = 0.15;
      pen.setLineDash(dashed ? [3, 4.5] : []);
      this.line(points);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  drawTrails(frame, before) {
    const { pen } = this;
    const trails = new Map();
    for (const { scene } of before.slice(-TRAIL_STEPS)) {
      for (const [id, x, y] of [scene.ego, ...scene.cars]) {
        if (!trails.has(id)) trails.set(id, []);
        trails.get(id).push([x, y]);
      }
    }
    pen.lineCap = "round";
    for (const [id, points] of trails) {
      for (let i = 1; i < points.length; i++) {
        pen.strokeStyle = alpha(id === -1 ? SELF : "#8d97a5", 0.5 * (i / points.length) ** 1.5);
        pen.lineWidth = 0.35;
        this.line([points[i - 1], points[i]]);
        pen.stroke();
      }
    }
  }

  /** Points around the ego car, by azimuth: so many metres away. */
  around(metres) {
    const { x, y, heading } = this.ego;
    return metres.map((range, azimuth) => {
      const angle = heading + (azimuth * 2 * Math.PI) / metres.length;
      return [x + range * Math.cos(angle), y + range * Math.sin(angle)];
    });
  }

  drawRings(frame) {
    const { pen } = this;
    const smooth = (metres) => this.around(refine(metres));
    const visible = this.stage.visible_m;
    if (this.shown.has("fog") && visible) {
      pen.strokeStyle = alpha(SOFT, 0.8);
      pen.lineWidth = 1.2 / this.scale;
      pen.setLineDash([0.5, 0.5]);
      this.line(smooth(visible), true);
      pen.stroke();
      pen.setLineDash([]);
    }
    const nearest = (belief) =>
      belief?.range && Array.from({ length: AZIMUTHS }, (_, azimuth) =>
        Math.min(...[0, 1, 2].map((band) => belief.range[band * AZIMUTHS + azimuth] ?? NOWHERE)));
    const robot = this.shown.has("robot") && nearest(frame.robot);
    if (robot) {
      pen.strokeStyle = alpha(ROBOT, 0.85);
      pen.lineWidth = 1.6 / this.scale;
      this.line(this.around(robot), true);
      pen.stroke();
    }
    const person = this.shown.has("person") && nearest(frame.human);
    if (person) {
      pen.fillStyle = alpha(PERSON, 0.1);
      pen.strokeStyle = alpha(PERSON, 0.6);
      pen.lineWidth = 1 / this.scale;
      this.line(this.around(person), true);
      pen.fill();
      pen.stroke();
    }
    if (this.shown.has("sight") && this.sight) {
      pen.fillStyle = alpha(PERSON, 0.08);
      pen.strokeStyle = PERSON;
      pen.lineWidth = 1.8 / this.scale;
      this.line(smooth(this.sight), true);
      pen.fill();
      pen.stroke();
    }
  }

  drawLidar({ range }) {
    const { pen } = this;
    const { x, y } = this.ego;
    for (let band = 0; band < 3; band++) {
      const metres = range.slice(band * AZIMUTHS, (band + 1) * AZIMUTHS);
      this.around(metres.map((range) => range ?? NOWHERE)).forEach(([px, py], azimuth) => {
        const isReturn = metres[azimuth] !== null;
        if (!isReturn && band) return;
        pen.strokeStyle = alpha(BANDS[band], isReturn ? 0.28 : 0.06);
        pen.lineWidth = 1 / this.scale;
        this.line([[x, y], [px, py]]);
        pen.stroke();
        if (!isReturn) return;
        pen.fillStyle = BANDS[band];
        pen.beginPath();
        pen.arc(px, py, (4.6 - band) / this.scale, 0, 2 * Math.PI);
        pen.fill();
      });
    }
  }

  drawCars(frame) {
    const boxes = new Set(frame.display?.boxes ?? []);
    const seen = new Set(frame.lidar?.object ?? []);
    const touched = frame.outcome?.collided ? frame.outcome.other : null;
    for (const car of frame.scene.cars) {
      const [id] = car;
      const colour = id === touched ? BAD : seen.has(id) ? "#c3cad3" : "#59626f";
      this.car(car, colour, boxes.has(id));
    }
    this.car(frame.scene.ego, SELF, false);
  }

  car([, x, y, heading, , length, width], colour, isBoxed) {
    const { pen } = this;
    pen.save();
    pen.translate(x, y);
    pen.rotate(heading);
    pen.fillStyle = colour;
    pen.beginPath();
    pen.roundRect(-length / 2, -width / 2, length, width, 0.45);
    pen.fill();
    pen.fillStyle = "rgb(8 10 13 / 55%)";
    pen.beginPath();
    pen.roundRect(length * 0.06, -width * 0.4, length * 0.16, width * 0.8, 0.15);
    pen.fill();
    if (isBoxed) {
      pen.strokeStyle = PERSON;
      pen.lineWidth = 0.28;
      pen.beginPath();
      pen.roundRect(-length / 2 - 0.7, -width / 2 - 0.7, length + 1.4, width + 1.4, 0.6);
      pen.stroke();
    }
    pen.restore();
  }

  drawScale(width, height) {
    const { pen } = this;
    const metres = [2, 5, 10, 20].find((metres) => metres * this.scale > 60) ?? 20;
    const [right, y] = [width - 22, height - 22];
    pen.strokeStyle = SOFT;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(right - metres * this.scale, y - 4);
    pen.lineTo(right - metres * this.scale, y);
    pen.lineTo(right, y);
    pen.lineTo(right, y - 4);
    pen.stroke();
    pen.fillStyle = SOFT;
    pen.font = "12px Inter, sans-serif";
    pen.textAlign = "center";
    pen.fillText(`${metres} m`, right - (metres * this.scale) / 2, y - 7);
  }
}

/** A ring with points in between, so that it looks as round as it is. */
function refine(metres, pieces = 4) {
  const at = (index) => metres[(index + metres.length) % metres.length];
  return metres.flatMap((_, index) =>
    Array.from({ length: pieces }, (_, piece) => {
      const t = piece / pieces;
      const [a, b, c, d] = [at(index - 1), at(index), at(index + 1), at(index + 2)];
      return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t * t + (3 * b - a - 3 * c + d) * t ** 3);
    }),
  );
}

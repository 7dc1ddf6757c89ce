// Calibration of a steering wheel and its pedals, which report no standard mapping: the person is asked for one
// movement after the other, and the number that moved most is the one.

import { make } from "../shared/dom.js";
import { read, readings } from "./input.js";

/** A number has moved when it differs from its rest by more than this. */
const MOVED = 0.25;

const STEPS = [
  ["rest", "Let go of everything", "Wheel straight, feet off the pedals."],
  ["left", "Turn the wheel all the way to the left", "Hold it there."],
  ["right", "Now all the way to the right", "Hold it there."],
  ["throttle", "Press the throttle down", "Wheel straight again. Hold the pedal."],
  ["brake", "Press the brake down", "Throttle released. Hold the brake."],
];

/** The number that differs most from its rest, except those that are taken. */
export function moved(rest, now, taken = []) {
  let best = null;
  now.forEach((value, index) => {
    const by = Math.abs(value - rest[index]);
    if (by > MOVED && !taken.includes(index) && (!best || by > best.by)) best = { index, by };
  });
  return best?.index ?? null;
}

/** What the five readings say; null if they say nothing. */
export function calibrate({ rest, left, right, throttle, brake }) {
  const wheel = moved(rest, left);
  if (wheel === null) return null;
  const gas = moved(rest, throttle, [wheel]);
  const stop = moved(rest, brake, [wheel]);
  const isSplit = gas !== null && stop !== null;
  if (!isSplit || Math.sign(left[wheel] - rest[wheel]) === Math.sign(right[wheel] - rest[wheel])) return null;
  return {
    wheel: { index: wheel, rest: rest[wheel], left: left[wheel], right: right[wheel] },
    throttle: { index: gas, rest: rest[gas], end: throttle[gas] },
    // Pedals that share a number lie on different sides of its rest.
    brake: { index: stop, rest: rest[stop], end: brake[stop] },
  };
}

/** Shows the calibration in a card, until it is done. */
export function openCalibration(card, driver, close) {
  let step = 0;
  let taken = {};
  let result = null;
  let device = null;
  let trouble = "";
  let handle = 0;

  const pad = () => {
    const pads = driver.pads();
    return pads.find((pad) => pad.index === device) ?? pads[0] ?? null;
  };

  const stop = () => {
    cancelAnimationFrame(handle);
    close();
  };

  const meters = make("div");
  const bar = (name, low, high, value) => {
    const zero = (0 - low) / (high - low);
    const at = (value - low) / (high - low);
    const fill = make("div", { class: "fill", style: `left:${100 * Math.min(zero, at)}%;width:${100 * Math.abs(at - zero)}%` });
    return make("div", { class: "meter" }, name, make("div", { class: "track" }, fill), make("output", {}, value.toFixed(2)));
  };

  const follow = () => {
    const now = pad();
    if (now && result) {
      const input = read(now, result);
      meters.replaceChildren(
        bar("Steer", -1, 1, -input.steer),
        bar("Throttle", 0, 1, Math.max(0, input.throttle)),
        bar("Brake", 0, 1, Math.max(0, -input.throttle)),
      );
    } else if (now) {
      meters.replaceChildren(...now.axes.slice(0, 6).map((value, index) => bar(`Axis ${index + 1}`, -1, 1, value)));
    }
    handle = requestAnimationFrame(follow);
  };

  const next = () => {
    const now = pad();
    if (!now) return render();
    taken[STEPS[step][0]] = readings(now);
    step += 1;
    trouble = "";
    if (step === STEPS.length) {
      result = calibrate(taken);
      if (!result) {
        trouble = "These movements could not be told apart. Please try once more.";
        [step, taken] = [0, {}];
      }
    }
    render();
  };

  const save = () => {
    driver.calibrations.save(pad(), result);
    stop();
  };

  function render() {
    const now = pad();
    const cancel = make("button", { onclick: stop }, "Close");
    if (!now) {
      card.replaceChildren(
        make("div", { class: "over" }, "Controls"),
        make("h1", {}, "No gamepad or wheel found"),
        make("p", {}, "Connect it, press one of its buttons so that the browser tells of it, and look again."),
        make("div", { class: "row" }, make("button", { class: "main", onclick: render }, "Look again"), cancel),
      );
      return;
    }
    device = now.index;
    if (result) {
      card.replaceChildren(
        make("div", { class: "over" }, now.id),
        make("h1", {}, "Try it"),
        make("p", {}, "Turn the wheel and press the pedals. Does everything move as you do?"),
        meters,
        make(
          "div",
          { class: "row" },
          make("button", { class: "main", id: "calibrated", onclick: save }, "Yes, use this"),
          make("button", { onclick: () => { [step, taken, result] = [0, {}, null]; render(); } }, "Once more"),
          cancel,
        ),
      );
      return;
    }
    const [, title, more] = STEPS[step];
    card.replaceChildren(
      make("div", { class: "over" }, `${now.id} · ${step + 1} of ${STEPS.length}`),
      make("h1", {}, title),
      make("p", {}, trouble || more),
      meters,
      make("div", { class: "row" }, make("button", { class: "main", id: "next", onclick: next }, "Next"), cancel),
    );
  }

  render();
  follow();
}

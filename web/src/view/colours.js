// The colours of the live view, as in style.css, for canvases.

export const SELF = "#62b5f0";
export const ROBOT = "#45c9a5";
export const PERSON = "#f2a93b";
export const SAID = "#f4e36a";
export const BAD = "#ff7a59";
export const TEXT = "#e8ebef";
export const SOFT = "#a3acb9";
export const FAINT = "#6c7684";
export const LINE = "#272e38";
export const PANEL = "#14181e";
export const RAISED = "#1b2028";
/** LIDAR by height: below 0.5 m, to 1.0 m, to 1.7 m; the higher, the lighter. */
export const BANDS = ["#5b7a99", "#86a9c9", "#c5dcee"];
/** Every process has its own, everywhere. */
export const PROCESSES = {
  world: "#a3acb9",
  belief: ROBOT,
  human: PERSON,
  planner: "#c69df0",
  renderer: SAID,
  driver: SELF,
};

export const alpha = (colour, share) => {
  const parts = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return `rgb(${parts.join(" ")} / ${Math.round(share * 100)}%)`;
};

/** A canvas at the screen's own resolution; its pen, width and height in CSS pixels. */
export function open(canvas, height) {
  const ratio = window.devicePixelRatio || 1;
  const box = canvas.getBoundingClientRect();
  const [wide, high] = [Math.round(box.width), Math.round(height ?? box.height)];
  if (height && canvas.style.height !== `${height}px`) canvas.style.height = `${height}px`;
  if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(high * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, wide, high);
  return { pen, width: wide, height: high };
}

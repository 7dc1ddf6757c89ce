// The speedometer.

import { make } from "../shared/dom.js";

const TOP_KMH = 60;
const [FROM, TO] = [-200, 20];

const point = (degrees, radius) => {
  const angle = (degrees * Math.PI) / 180;
  return `${(130 + radius * Math.cos(angle)).toFixed(2)} ${(118 + radius * Math.sin(angle)).toFixed(2)}`;
};
const arc = (from, to, radius) =>
  `M ${point(from, radius)} A ${radius} ${radius} 0 ${to - from > 180 ? 1 : 0} 1 ${point(to, radius)}`;
const degrees = (kmh) => FROM + ((TO - FROM) * Math.min(kmh, TOP_KMH)) / TOP_KMH;

export class Dash {
  constructor(element, limitKmh) {
    const ticks = Array.from({ length: 13 }, (_, i) => {
      const at = degrees(i * 5);
      const long = i % 2 === 0;
      return `<path d="M ${point(at, 104)} L ${point(at, long ? 95 : 99)}" stroke="rgb(232 235 239 / ${long ? 60 : 28}%)" stroke-width="${long ? 2 : 1.5}"/>`;
    });
    const numbers = [0, 20, 40, 60].map((kmh) => {
      const [x, y] = point(degrees(kmh), 82).split(" ");
      return `<text x="${x}" y="${y}" dy="4" text-anchor="middle" font-size="12" fill="rgb(232 235 239 / 60%)">${kmh}</text>`;
    });
    const holder = make("div");
    holder.innerHTML = `<svg viewBox="0 0 260 132" aria-label="Speed">
      <path d="${arc(FROM, TO, 110)}" fill="none" stroke="rgb(255 255 255 / 10%)" stroke-width="5" stroke-linecap="round"/>
      <path d="${arc(degrees(Math.min(limitKmh, TOP_KMH - 1)), TO, 110)}" fill="none" stroke="rgb(255 122 89 / 45%)" stroke-width="5" stroke-linecap="round"/>
      <path id="needle" fill="none" stroke="#62b5f0" stroke-width="5" stroke-linecap="round"/>
      ${ticks.join("")}${numbers.join("")}
      <text id="kmh" x="130" y="104" text-anchor="middle" font-size="46" font-weight="620" letter-spacing="-1.5" fill="#e8ebef">0</text>
      <text x="130" y="124" text-anchor="middle" font-size="12" fill="rgb(232 235 239 / 60%)">km/h</text>
    </svg>`;
    element.replaceChildren(holder.firstElementChild);
    this.needle = element.querySelector("#needle");
    this.number = element.querySelector("#kmh");
    this.element = element;
    this.shown = -1;
  }

  show(speed) {
    const kmh = Math.max(0, speed * 3.6);
    const rounded = Math.round(kmh);
    if (rounded !== this.shown) this.number.textContent = this.shown = rounded;
    this.needle.setAttribute("d", arc(FROM, Math.max(degrees(kmh), FROM + 0.5), 110));
  }
}

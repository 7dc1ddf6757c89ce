// Search and rescue's image: what its colours stand for, and how that is shown on a dark ground, with letters for who
// does not tell the colours apart.

const KINDS = [
  { name: "floor", colour: [0.8, 0.8, 0.8], fill: "#1f262f", letter: "" },
  { name: "wall", colour: [0.5, 0.1, 0.5], fill: "#465060", letter: "" },
  { name: "obstacle", colour: [1, 0, 0], fill: "#ff7a59", letter: "✕" },
  { name: "victim", colour: [0, 1, 0], fill: "#f2a93b", letter: "V" },
  { name: "person", colour: [0, 0, 1], fill: "#1f262f", letter: "" },
  { name: "carrying", colour: [0, 1, 1], fill: "#1f262f", letter: "" },
  { name: "entrance", colour: [1, 1, 0], fill: "#2f7d66", letter: "E" },
];

/** The kind of cell that a colour looks most like, and how clearly (0 to 1). */
export function kindOf(colour) {
  const far = (kind) => kind.colour.reduce((sum, value, i) => sum + (value - colour[i]) ** 2, 0);
  const kind = KINDS.reduce((best, kind) => (far(kind) < far(best) ? kind : best));
  return { ...kind, clarity: Math.max(0, 1 - Math.sqrt(far(kind)) / 0.8) };
}

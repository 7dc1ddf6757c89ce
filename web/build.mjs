// Makes web/dist, which is committed and compiled into the program: `npm ci && npm run build`. The sentences are made
// by make_sentences.py. The same versions (package-lock.json) give the same bytes.

import { build } from "esbuild";
import { copyFile, mkdir, readFile, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const at = (...parts) => join(here, ...parts);

await mkdir(at("dist"), { recursive: true });
await build({
  absWorkingDir: here,
  entryPoints: { cockpit: "src/cockpit/main.js", view: "src/view/main.js" },
  outdir: "dist",
  bundle: true,
  minify: true,
  format: "esm",
  target: ["firefox115", "chrome115"],
  legalComments: "none",
  charset: "utf8",
});
for (const file of ["cockpit.html", "view.html", "style.css"]) {
  await copyFile(at("src", file), at("dist", file));
}
const inter = at("node_modules/@fontsource-variable/inter");
await copyFile(join(inter, "files/inter-latin-wght-normal.woff2"), at("dist/inter.woff2"));

const licence = async (title, path) => `${title}\n\n${(await readFile(path, "utf8")).trim()}\n`;
const parts = [
  "What these pages are made of beside MIRROR's own code (MIT or Apache-2.0).\n",
  await licence("three.js", at("node_modules/three/LICENSE")),
  await licence("The typeface Inter (inter.woff2)", join(inter, "LICENSE")),
  "The sentences (sentences.bin) were spoken by hibari-tts 0.2.1, https://github.com/MMWilliams/hibari, Apache-2.0.\n",
];
await writeFile(at("dist/licences.txt"), parts.join(`\n${"-".repeat(80)}\n\n`));

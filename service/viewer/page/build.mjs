// Bundles src/ into dist/ and stores the hash of the sources, so that a test can tell a stale bundle.
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const banner = "/* scopt viewer; contains three.js (MIT), see LICENSES.txt */";
const common = { bundle: true, minify: true, target: "es2022", legalComments: "none", charset: "ascii" };
mkdirSync("dist", { recursive: true });
await build({ ...common, entryPoints: ["src/main.ts"], format: "iife", outfile: "dist/viewer.js", banner: { js: banner } });
await build({ ...common, entryPoints: ["src/style.css"], outfile: "dist/viewer.css" });

const three = JSON.parse(readFileSync("node_modules/three/package.json", "utf8"));
const licence = readFileSync("node_modules/three/LICENSE", "utf8");
writeFileSync("dist/LICENSES.txt", `viewer.js contains three.js ${three.version} (https://threejs.org):\n\n${licence}`);

const hash = createHash("sha256");
for (const name of ["build.mjs", "package.json", ...readdirSync("src").sort().map((entry) => `src/${entry}`)]) {
  hash.update(`${name}\n`).update(readFileSync(name));
}
writeFileSync("dist/sources.sha256", `${hash.digest("hex")}\n`);

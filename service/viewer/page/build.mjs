// Bundles src/ into dist/ and stores the hash of the sources, so that a test can tell a stale bundle.
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const banner = "/* scopt viewer; contains three.js (MIT), see LICENSES.txt */";
const common = { bundle: true, minify: true, target: "es2022", legalComments: "none", charset: "ascii" };
mkdirSync("dist", { recursive: true });
const programs = { viewer: "src/main.ts", scene: "src/scene.ts", console: "src/console.ts" };
for (const [name, entry] of Object.entries(programs)) {
  await build({ ...common, entryPoints: [entry], format: "iife", outfile: `dist/${name}.js`, banner: { js: banner } });
}
await build({ ...common, entryPoints: ["src/style.css"], outfile: "dist/viewer.css" });
await build({ ...common, entryPoints: ["src/console.css"], outfile: "dist/console.css" });

const three = JSON.parse(readFileSync("node_modules/three/package.json", "utf8"));
const licence = readFileSync("node_modules/three/LICENSE", "utf8");
writeFileSync("dist/LICENSES.txt", `viewer.js, scene.js and console.js contain three.js ${three.version} (https://threejs.org):\n\n${licence}`);

const hash = createHash("sha256");
for (const name of ["build.mjs", "package.json", ...readdirSync("src").sort().map((entry) => `src/${entry}`)]) {
  hash.update(`${name}\n`).update(readFileSync(name));
}
writeFileSync("dist/sources.sha256", `${hash.digest("hex")}\n`);

// Bundle the page: src/main.js and src/page.css to ../built/page.js and ../built/page.css, minified.
import { build } from "esbuild";
import { statSync } from "node:fs";
import { fileURLToPath } from "node:url";

const here = (/** @type {string} */ path) => fileURLToPath(new URL(path, import.meta.url));

await build({
  entryPoints: { page: here("src/main.js") },
  outdir: here("../built"),
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "ascii",
  legalComments: "eof",
  footer: { js: "/* uPlot: Copyright (c) 2022 Leon Sorokin, MIT licence; see THIRD_PARTY_NOTICES.md of dualarm */" },
  logLevel: "warning",
});
for (const name of ["page.js", "page.css"]) {
  console.log(`${name}: ${(statSync(here(`../built/${name}`)).size / 1e3).toFixed(0)} kB`);
}

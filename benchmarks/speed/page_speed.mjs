// Opens a page from disk in headless Chromium with software rendering, and prints as JSON how quick it is.
//
// node page_speed.mjs PLAYWRIGHT CHROMIUM PAGE
//
// Times come twice: by the clock, which other programs on the machine lengthen, and as processor time of the browser's
// processes, which they lengthen less.
import { readFileSync, readdirSync } from "node:fs";
import { pathToFileURL } from "node:url";

const OPENINGS = 3;
const FRAMES = 60;
const TICK = 10;

const [playwright, executablePath, page] = process.argv.slice(2);
const { chromium } = await import(pathToFileURL(playwright).href);
const server = await chromium.launchServer({
  executablePath,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"],
});
try {
  console.log(JSON.stringify(await measure(await chromium.connect(server.wsEndpoint()))));
} finally {
  await server.close();
}

/** Returns the processor time of each process of the browser [ms]. */
function processorTimes() {
  const rows = readdirSync("/proc").filter((name) => /^\d+$/.test(name)).flatMap((pid) => {
    try {
      const fields = readFileSync(`/proc/${pid}/stat`, "utf8").replace(/^.*\) /s, "").split(" ");
      return [{ pid: Number(pid), parent: Number(fields[1]), time: TICK * (Number(fields[11]) + Number(fields[12])) }];
    } catch {
      return [];
    }
  });
  const own = new Set([server.process().pid]);
  for (let before = 0; before !== own.size; ) {
    before = own.size;
    for (const { pid, parent } of rows) if (own.has(parent)) own.add(pid);
  }
  return new Map(rows.filter(({ pid }) => own.has(pid)).map(({ pid, time }) => [pid, time]));
}

/** Returns how much processor time each process used since then [ms], the busiest first. */
function since(before) {
  const used = [...processorTimes()].map(([pid, time]) => time - (before.get(pid) ?? 0));
  return used.sort((a, b) => b - a);
}

function sum(values) {
  return values.reduce((a, b) => a + b, 0);
}

async function measure(browser) {
  const openings = [];
  let tab;
  for (let k = 0; k < OPENINGS; k++) {
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, offline: true });
    tab = await context.newPage();
    const before = processorTimes();
    await tab.goto(pathToFileURL(page).href);
    await tab.waitForFunction(() => window.dualarm?.ready);
    const clock = (await tab.evaluate(() => window.dualarm.readyAfter)) / 1e3;
    openings.push({ clock, processor: sum(since(before)) / 1e3 });
    if (k < OPENINGS - 1) await context.close();
  }
  await tab.waitForTimeout(1000);
  const before = processorTimes();
  const elapsed = await tab.evaluate(
    (frames) =>
      new Promise((resolve) => {
        const start = performance.now();
        const scrub = document.querySelector(".scrub");
        let count = 0;
        const step = () => {
          scrub.value = String((count * 0.05) % Number(scrub.max));
          scrub.dispatchEvent(new Event("input"));
          if (++count > frames) resolve((performance.now() - start) / 1e3);
          else requestAnimationFrame(step);
        };
        requestAnimationFrame(step);
      }),
    FRAMES,
  );
  const used = since(before);
  return {
    first_picture: Math.min(...openings.map(({ clock }) => clock)),
    first_picture_processor: Math.min(...openings.map(({ processor }) => processor)),
    frames_per_second: FRAMES / elapsed,
    frame_processor: sum(used) / FRAMES / 1e3,
    frame_busiest_process: used[0] / FRAMES / 1e3,
  };
}

// Opens a page from disk in Chromium with the network off, does what a reader does, and prints what was seen as JSON.
//
// node in_browser.mjs PLAYWRIGHT CHROMIUM PAGE TIMES
import { pathToFileURL } from "node:url";

const [playwright, executablePath, page, timesText] = process.argv.slice(2);
const { chromium } = await import(pathToFileURL(playwright).href);
const times = JSON.parse(timesText);

const browser = await chromium.launch({
  executablePath,
  args: [
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
  ],
});
try {
  console.log(JSON.stringify(await look(browser)));
} finally {
  await browser.close();
}

/** Returns the share of the window that the 3-D view has, and what does not fit. */
function layoutOf(tab) {
  return tab.evaluate(() => {
    const box = (name) => document.querySelector(name).getBoundingClientRect();
    const { width, height } = box(".viewer");
    return {
      share: (width * height) / (innerWidth * innerHeight),
      scrolled: document.documentElement.scrollWidth - innerWidth,
      playBarEnds: box(".transport").bottom - innerHeight,
    };
  });
}

/** Returns the cursor's time after half a second, of a page whose reader does not prefer stillness. */
async function opened(browser, hash) {
  const tab = await (await browser.newContext({ offline: true })).newPage();
  await tab.goto(pathToFileURL(page).href + hash);
  await tab.waitForFunction(() => window.dualarm?.ready);
  await tab.waitForTimeout(500);
  const time = await tab.evaluate(() => window.dualarm.time);
  await tab.close();
  return time;
}

async function look(browser) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, offline: true, reducedMotion: "reduce" });
  const tab = await context.newPage();
  const errors = [];
  const requests = [];
  tab.on("console", (message) => {
    if (["error", "warning"].includes(message.type())) errors.push(message.text());
  });
  tab.on("pageerror", (error) => errors.push(String(error)));
  tab.on("request", (request) => requests.push(request.url()));
  const open = async () => {
    await tab.goto(pathToFileURL(page).href);
    await tab.waitForFunction(() => window.dualarm?.ready);
    return tab.evaluate(() => window.dualarm.readyAfter);
  };
  const firstPictures = [await open(), await open(), await open()];
  const seen = { firstPicture: Math.min(...firstPictures) / 1e3 };

  seen.layouts = [];
  for (const [width, height] of [[1280, 720], [390, 844]]) {
    await tab.setViewportSize({ width, height });
    seen.layouts.push(await layoutOf(tab));
  }
  await tab.setViewportSize({ width: 1280, height: 800 });
  for (const part of ["curves", "report"]) await tab.locator(`[data-part=${part}]`).click();
  await tab.locator(".splitter").focus();
  const height = () => tab.evaluate(() => document.querySelector(".timeline").getBoundingClientRect().height);
  const before = await height();
  await tab.keyboard.press("ArrowUp");
  seen.higherBy = (await height()) - before;
  await open();
  seen.stillHigherBy = (await height()) - before;
  seen.curvesShown = [];
  for (const size of [[390, 844], [1280, 800]]) {
    await tab.setViewportSize({ width: size[0], height: size[1] });
    await tab.waitForTimeout(200);
    seen.curvesShown.push(await tab.evaluate(() => !document.querySelector("#page").classList.contains("no-curves")));
  }

  seen.linkedTime = await opened(browser, "#t=0.25");
  seen.playedAlone = await opened(browser, "");

  seen.arms = await tab.evaluate(() => [...document.querySelectorAll(".status b")].map((b) => b.textContent));
  seen.states = [];
  for (const time of times) {
    seen.states.push(
      await tab.evaluate(
        ([t, arms]) => {
          window.dualarm.setTime(t);
          const tools = Object.fromEntries(arms.map((arm) => [arm, window.dualarm.toolPosition(arm)]));
          return { time: window.dualarm.time, joints: window.dualarm.jointPositions(), tools };
        },
        [time, seen.arms],
      ),
    );
  }

  await tab.evaluate(() => window.dualarm.setTime(0));
  await tab.keyboard.press("Space");
  await tab.waitForTimeout(500);
  seen.playedTo = await tab.evaluate(() => window.dualarm.time);
  await tab.keyboard.press("Space");
  const paused = await tab.evaluate(() => window.dualarm.time);
  await tab.waitForTimeout(200);
  seen.stands = (await tab.evaluate(() => window.dualarm.time)) === paused;

  await tab.evaluate(() => window.dualarm.setTime(0));
  const chart = await tab.locator("canvas.gantt").boundingBox();
  const picture = () => tab.locator("canvas.view").screenshot();
  await tab.waitForTimeout(800);
  const atStart = await picture();
  await tab.mouse.click(chart.x + 0.6 * chart.width, chart.y + 75);
  seen.clickedTo = await tab.evaluate(() => window.dualarm.time);
  seen.clickedJoints = await tab.evaluate(() => window.dualarm.jointPositions());
  await tab.waitForTimeout(800);
  seen.pictureChanged = !atStart.equals(await picture());

  await tab.locator(".tabs button", { hasText: "Stages" }).click();
  await tab.locator(".panel.selected tbody tr").nth(1).click();
  seen.rowLedTo = await tab.evaluate(() => window.dualarm.time);

  seen.framesPerSecond = await tab.evaluate(
    () =>
      new Promise((resolve) => {
        const start = performance.now();
        let frames = 0;
        const scrub = document.querySelector(".scrub");
        const step = () => {
          scrub.value = String((frames++ * 0.05) % Number(scrub.max));
          scrub.dispatchEvent(new Event("input"));
          const elapsed = (performance.now() - start) / 1e3;
          if (elapsed > 3) resolve(frames / elapsed);
          else requestAnimationFrame(step);
        };
        requestAnimationFrame(step);
      }),
  );
  for (const button of await tab.locator(".group button, .view-bar button, .tabs button").all()) {
    await button.click();
  }
  await tab.locator(".joints summary").click();
  for (const button of await tab.locator(".joint-list button").all()) await button.click();
  await tab.locator(".joints summary").click();
  await tab.mouse.move(chart.x + 0.5 * chart.width, chart.y + 75);
  await tab.mouse.wheel(0, -900);
  for (const key of ["d", "ArrowRight", "ArrowUp", "t", "ArrowUp", "e", "ArrowDown", "z", "0", "f", "+", "-", "?", "Escape", "End"]) {
    await tab.keyboard.press(key);
  }
  seen.endsAt = await tab.evaluate(() => window.dualarm.time);
  seen.text = await tab.evaluate(() => document.querySelector("#page").textContent);
  seen.elements = await tab.evaluate(() => document.querySelectorAll("#page img:not(.paper), #page script").length);
  seen.evil = await tab.evaluate(() => window.evil ?? null);
  return { ...seen, errors, requests };
}

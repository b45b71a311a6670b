// Opens a page of two plans in Chromium, clicks on the middle of their common axis, and prints what was seen as JSON.
//
// node both_in_browser.mjs PLAYWRIGHT CHROMIUM PAGE
import { pathToFileURL } from "node:url";

const [playwright, executablePath, page] = process.argv.slice(2);
const { chromium } = await import(pathToFileURL(playwright).href);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
try {
  const tab = await (await browser.newContext({ viewport: { width: 1600, height: 900 }, offline: true })).newPage();
  const errors = [];
  tab.on("console", (message) => ["error", "warning"].includes(message.type()) && errors.push(message.text()));
  tab.on("pageerror", (error) => errors.push(String(error)));
  await tab.goto(pathToFileURL(page).href);
  await tab.waitForFunction(() => [...document.querySelectorAll("iframe")].every((frame) => frame.contentWindow.dualarm?.ready));
  const seen = await tab.evaluate(() => {
    const axis = document.getElementById("axis");
    const x = (line) => Number(line.getAttribute("x1"));
    const lines = [...axis.querySelectorAll("line")];
    const cursor = lines.find((line) => line.classList.contains("cursor"));
    return { bars: axis.querySelectorAll("rect").length, ends: lines.filter((line) => line !== cursor).map(x), start: x(cursor), width: axis.viewBox.baseVal.width };
  });
  const box = await tab.locator("#axis").boundingBox();
  const middle = (seen.start + seen.ends[0]) / 2 / seen.width;
  await tab.mouse.click(box.x + middle * box.width, box.y + box.height / 2);
  await tab.waitForTimeout(200);
  const times = await tab.evaluate(() => [...document.querySelectorAll("iframe")].map((frame) => frame.contentWindow.dualarm.time));
  await tab.setViewportSize({ width: 390, height: 844 });
  await tab.waitForTimeout(500);
  const narrow = await tab.evaluate(() => {
    const frames = [...document.querySelectorAll("iframe")].map((frame) => frame.getBoundingClientRect());
    return { scrolled: document.documentElement.scrollWidth - innerWidth, widths: frames.map(({ width }) => width), below: frames[1].top - frames[0].bottom };
  });
  console.log(JSON.stringify({ ...seen, times, errors, narrow }));
} finally {
  await browser.close();
}

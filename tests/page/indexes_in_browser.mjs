// Opens files from disk in Chromium with the network off, chooses rows of their tables, and prints what is seen as JSON.
//
// node indexes_in_browser.mjs PLAYWRIGHT CHROMIUM SIDE_BY_SIDE INDEX
import { pathToFileURL } from "node:url";

const [playwright, executablePath, both, index] = process.argv.slice(2);
const { chromium } = await import(pathToFileURL(playwright).href);

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

async function look(browser) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, offline: true });
  const tab = await context.newPage();
  const errors = [];
  const requests = [];
  tab.on("console", (message) => {
    if (["error", "warning"].includes(message.type())) errors.push(message.text());
  });
  tab.on("pageerror", (error) => errors.push(String(error)));
  tab.on("request", (request) => requests.push(request.url()));

  const state = async () => {
    await tab.waitForFunction(() =>
      [...document.querySelectorAll("iframe")].every((frame) => frame.contentWindow.dualarm?.ready),
    );
    await tab.waitForTimeout(200);
    return tab.evaluate(() =>
      [...document.querySelectorAll("iframe")].map((frame) => ({
        title: frame.contentDocument.querySelector("h1").textContent,
        time: frame.contentWindow.dualarm.time,
        width: frame.contentWindow.innerWidth,
      })),
    );
  };
  const seen = {};
  await tab.goto(pathToFileURL(both).href);
  seen.first = await state();
  await tab.evaluate(() => document.querySelectorAll("iframe")[1].contentWindow.dualarm.setTime(0.5));
  seen.moved = await state();
  const rows = tab.locator("tbody tr[tabindex]");
  await rows.nth(2).click();
  seen.third = await state();
  await rows.nth(0).focus();
  await tab.keyboard.press("Enter");
  seen.alone = await state();
  seen.marked = await rows.evaluateAll((all) => all.map((row) => row.className));

  await tab.goto(pathToFileURL(index).href);
  await tab.locator("a").first().click();
  await tab.waitForFunction(() => window.dualarm?.ready);
  seen.led = await tab.locator("h1").textContent();
  return { ...seen, errors, requests };
}

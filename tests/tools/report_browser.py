#!/usr/bin/env python3
"""Opens a report's page from disk in a headless Chromium and works through it as a reader would.

    report_browser.py REPORT_DIR [--screenshots DIR] [--golden DIR [--keep]] [--planes-per-s N]

Needs chromium and chromedriver (Debian: chromium, chromium-driver); without them it says so and ends with 0.
Checked: no console error, no network request, planes by keyboard and slider, layers, zoom, measuring, the 3-D model and a
click in it, printing to paper, narrow screens, no script at all. With --golden, parts of the page are compared with the pictures kept there: at
GOLDEN_WIDTH pixels across, so that fonts and smoothing count little; --keep writes them anew. Ends with 1 where something does not hold.
How fast planes follow one another is told, and judged with --planes-per-s alone: it depends on the machine and on what else it does.
"""

import argparse

import base64
import json
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

GOLDEN_WIDTH = 240
# Mean difference of all pixels, of 255; part of the pixels that differ by more than a quarter.
MOST_MEAN, MOST_PART = 3.5, 0.015
LEFT, RIGHT, HOME, END = "\ue012", "\ue014", "\ue011", "\ue010"


class Driver:
    """The W3C WebDriver protocol, as far as it is needed here."""

    def __init__(self, script=True):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.process = subprocess.Popen(
            ["chromedriver", f"--port={self.port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.session = None
        arguments = ["--headless=new", "--no-sandbox", "--window-size=1400,1000", "--enable-unsafe-swiftshader"]
        options = {"args": arguments, "perfLoggingPrefs": {"enableNetwork": True}}
        if not script:
            options["prefs"] = {"profile.managed_default_content_settings.javascript": 2}
        wanted = {
            "goog:chromeOptions": options,
            "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
        }
        answer = self._wait_for(lambda: self.call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}}))
        self.session = answer["sessionId"]
        self.call("POST", "/timeouts", {"script": 100_000})

    def _wait_for(self, attempt):
        for _ in range(100):
            try:
                return attempt()
            except (ConnectionError, urllib.error.URLError):
                time.sleep(0.1)
        raise TimeoutError("chromedriver did not answer")

    def call(self, method, path, body=None):
        url = f"http://127.0.0.1:{self.port}" + (f"/session/{self.session}" if self.session else "") + path
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(url, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(f"{path}: {error.read().decode()[:400]}") from error

    def open(self, path):
        self.call("POST", "/url", {"url": path.resolve().as_uri()})

    def run(self, script, *args):
        return self.call("POST", "/execute/sync", {"script": script, "args": list(args)})

    def run_async(self, script, *args):
        return self.call("POST", "/execute/async", {"script": script, "args": list(args)})

    def actions(self, kind, steps, **more):
        self.call("POST", "/actions", {"actions": [{"type": kind, "id": kind, "actions": steps, **more}]})

    def keys(self, keys):
        steps = [{"type": move, "value": key} for key in keys for move in ("keyDown", "keyUp")]
        self.actions("key", steps)

    def pointer(self, places):
        """Presses at the first place, goes to the others, lets go."""
        moves = [{"type": "pointerMove", "duration": 20, "x": round(x), "y": round(y)} for x, y in places]
        steps = [moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]
        self.actions("pointer", steps, parameters={"pointerType": "mouse"})

    def box(self, selector):
        self.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        return self.run(
            "var b = document.querySelector(arguments[0]).getBoundingClientRect(); return [b.x, b.y, b.width, b.height]",
            selector,
        )

    def picture(self, path):
        path.write_bytes(base64.b64decode(self.call("GET", "/screenshot")))

    def log(self, kind):
        return self.call("POST", "/se/log", {"type": kind})

    def close(self):
        if self.session:
            self.call("DELETE", "")
        self.process.terminate()
        self.process.wait()


class Checks:
    def __init__(self):
        self.failed = 0

    def __call__(self, name, holds, found=""):
        print(f"{'ok  ' if holds else 'FAIL'} {name}{f': {found}' if found != '' else ''}")
        self.failed += not holds


PIXELS = """
var c = document.querySelector(arguments[0]), w = c.width, h = c.height, own = document.createElement('canvas');
own.width = w; own.height = h; var pen = own.getContext('2d'); pen.drawImage(c, 0, 0);
var d = pen.getImageData(0, 0, w, h).data, n = 0;
var is = {red: function (r, g, b) { return r > 200 && g < 110 && b < 110; },
          green: function (r, g, b) { return g > 200 && r < 130 && b < 170; },
          blue: function (r, g, b) { return b > 200 && r < 90; },
          any: function (r, g, b) { return Math.max(r, g, b) > 60; }}[arguments[1]];
for (var i = 0; i < d.length; i += 4) { if (is(d[i], d[i + 1], d[i + 2])) { n += 1; } }
return n;"""
SETTLE = "var done = arguments[0]; requestAnimationFrame(function () { requestAnimationFrame(function () { setTimeout(done, 300); }); });"
SCRUB = """
var done = arguments[0], n = document.querySelectorAll('#gallery figure').length, i = 0, from = performance.now(), frames = window.lumenfabView.frames();
function step() {
  document.dispatchEvent(new KeyboardEvent('keydown', {key: i % n === 0 ? 'Home' : 'ArrowRight', bubbles: true}));
  i += 1;
  if (i < 4 * n) { requestAnimationFrame(step); }
  else { requestAnimationFrame(function () { done([window.lumenfabView.frames() - frames, (performance.now() - from) / 1000]); }); }
}
step();"""


SHRINK = """
var shot = arguments[0], kept = arguments[1], width = arguments[2], done = arguments[3];
function load(data, then) { var i = new Image(); i.onload = function () { then(i); }; i.src = 'data:image/png;base64,' + data; }
function drawn(image, w, h) {
  var c = document.createElement('canvas'); c.width = w; c.height = h;
  var pen = c.getContext('2d'); pen.imageSmoothingQuality = 'high'; pen.fillStyle = '#fff'; pen.fillRect(0, 0, w, h); pen.drawImage(image, 0, 0, w, h);
  return c;
}
load(shot, function (image) {
  var small = drawn(image, width, Math.round(width * image.height / image.width));
  var answer = { png: small.toDataURL('image/png').split(',')[1], height: small.height };
  if (!kept) { done(answer); return; }
  load(kept, function (old) {
    answer.kept_height = old.height;
    var a = small.getContext('2d').getImageData(0, 0, width, small.height).data;
    var b = drawn(old, width, small.height).getContext('2d').getImageData(0, 0, width, small.height).data;
    var sum = 0, far = 0;
    for (var i = 0; i < a.length; i += 4) {
      var d = Math.max(Math.abs(a[i] - b[i]), Math.abs(a[i + 1] - b[i + 1]), Math.abs(a[i + 2] - b[i + 2]));
      sum += d; far += d > 64;
    }
    answer.mean = sum / (a.length / 4); answer.part = far / (a.length / 4);
    done(answer);
  });
});"""


class Golden:
    """Pictures of parts of the page, compared with those that were kept."""

    def __init__(self, folder, keep, check):
        self.folder, self.keep, self.check = folder, keep, check

    def compare(self, driver, name, selector):
        if not self.folder:
            return
        driver.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        driver.run_async(SETTLE)
        found = driver.call("POST", "/element", {"using": "css selector", "value": selector})
        shot = driver.call("GET", f"/element/{next(iter(found.values()))}/screenshot")
        path = self.folder / f"{name}.png"
        if self.keep:
            self.folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(base64.b64decode(driver.run_async(SHRINK, shot, None, GOLDEN_WIDTH)["png"]))
            return
        kept = base64.b64encode(path.read_bytes()).decode()
        answer = driver.run_async(SHRINK, shot, kept, GOLDEN_WIDTH)
        holds = abs(answer["height"] - answer["kept_height"]) <= 3 and answer["mean"] <= MOST_MEAN and answer["part"] <= MOST_PART
        told = f"mean {answer['mean']:.1f} of 255, {100 * answer['part']:.1f} % far off, {answer['height']} rows for {answer['kept_height']}"
        self.check(f"{name} looks as it was kept", holds, told)


def look(driver, name, folder, selector=None):
    if selector:
        driver.run("document.querySelector(arguments[0]).scrollIntoView()", selector)
    driver.run_async(SETTLE)
    driver.picture(folder / f"{name}.png")


def planes(driver, check):
    n = driver.run("return document.querySelectorAll('#gallery figure').length")
    plane = lambda: driver.run("return window.lumenfabView.plane()")
    driver.keys([HOME])
    check("Home shows the first plane", plane() == 0)
    driver.keys([RIGHT, RIGHT, LEFT])
    check("arrow keys leaf through the planes", plane() == 1)
    driver.run_async(SETTLE)
    title = driver.run("return document.getElementById('view-title').textContent")
    check("the plane is named", title.startswith("CT plane 1, z "), title)
    driver.keys([END])
    check("End shows the last plane", plane() == n - 1)
    driver.run("var s = document.getElementById('slider'); s.value = 2; s.dispatchEvent(new Event('input'))")
    check("the slider leads to its plane", plane() == 2)
    driver.run_async(SETTLE)
    shown = driver.run("return document.querySelectorAll('#plane-table tr.current').length")
    check("the table marks the plane", shown == 1)


def defects(driver, check):
    if not driver.run("return !!document.querySelector('#defect-table button')"):
        return
    driver.keys([END])
    wanted = driver.run("var b = document.querySelector('#defect-table button'); b.click(); return b.dataset.plane")
    plane = driver.run("return document.querySelectorAll('#gallery figure')[window.lumenfabView.plane()].dataset.plane")
    check("a click on a defect's place shows its plane", plane == wanted, f"plane {plane}")


def layers(driver, check):
    pixels = lambda colour: driver.run(PIXELS, "#view", colour)
    driver.run_async(SETTLE)
    for key, colour, name in (("3", "red", "solid"), ("4", "blue", "toolpaths")):
        before = pixels(colour)
        driver.keys([key])
        driver.run_async(SETTLE)
        without = pixels(colour)
        driver.keys([key])
        driver.run_async(SETTLE)
        found = f"{before} pixels, {without} without"
        check(f"the layer of the {name} can be taken away and brought back", before > 50 > without and pixels(colour) == before, found)
    driver.keys(["3"])
    driver.run_async(SETTLE)
    before = pixels("green")
    driver.keys(["2"])
    driver.run_async(SETTLE)
    check("so can the segmented boundary", before > 50 > pixels("green"), before)
    driver.keys(["2", "3"])


def measure(driver, check):
    driver.keys(["0", "m"])
    x, y, width, height = driver.box("#view")
    scale = driver.run(
        "var v = document.querySelector('#gallery svg').viewBox.baseVal, b = document.getElementById('view').getBoundingClientRect();"
        "return 100 * Math.min(b.width / v.width, b.height / v.height)"
    )
    at = (x + 0.4 * width, y + 0.5 * height)
    driver.pointer([at, (at[0] + 5 * scale, at[1])])
    words = driver.run("return document.getElementById('readout').textContent")
    length = float(words.split()[1])
    check("5 mm are measured as 5 mm", abs(length - 5) < 1.2 / scale, words)


def model(driver, check, folder):
    if driver.run("return !document.getElementById('no-model').hidden"):
        print("skip the 3-D model: this browser has no WebGL")
        return
    x, y, width, height = driver.box("#model")
    check("the 3-D model is drawn", driver.run(PIXELS, "#model", "any") > 2000)
    driver.keys([HOME])
    driver.run_async(SETTLE)
    hit = False
    for part in range(4, 30):
        driver.pointer([(x + width * (0.3 + 0.4 * (part % 9) / 8), y + height * part / 34)])
        hit = hit or driver.run("return window.lumenfabView.plane()") > 0
    check("a click in the 3-D model shows its plane", hit)
    driver.pointer([(x + 0.4 * width, y + 0.5 * height), (x + 0.6 * width, y + 0.55 * height)])
    look(driver, "model", folder)


def outside(driver, check):
    errors = [e["message"] for e in driver.log("browser") if e["level"] in ("SEVERE", "WARNING")]
    errors = [e for e in errors if "GPU stall" not in e and "GL Driver" not in e]
    check("nothing is said on the console", not errors, errors or "")
    urls = []
    for entry in driver.log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            urls.append(message["params"]["request"]["url"])
    others = [u[:80] for u in urls if not u.startswith("data:") and not u.endswith("/index.html")]
    check("nothing but the page itself is asked for", not others, others or "")


def narrow(driver, check):
    driver.call("POST", "/window/rect", {"width": 520, "height": 1000})
    driver.run_async(SETTLE)
    wide = driver.run("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
    check("a narrow screen needs no scrolling to the side", wide <= 1, f"{wide} pixels too wide")
    driver.call("POST", "/window/rect", {"width": 1400, "height": 1000})
    driver.run_async(SETTLE)


def scrub(driver, check, least):
    driver.run("document.getElementById('browser').scrollIntoView()")
    driver.run_async(SETTLE)
    rounds = [driver.run_async(SCRUB) for _ in range(3)]
    rates = [n / seconds for n, seconds in rounds]
    told = ", ".join(f"{rate:.0f}" for rate in rates)
    print(f"     leafing by keys, planes drawn a second, three rounds: {told}")
    if least:
        check(f"{least} planes a second are drawn", max(rates) >= least, f"{max(rates):.0f}")


def with_script(page, folder, check, golden, least):
    driver = Driver()
    try:
        driver.open(page)
        look(driver, "top", folder)
        golden.compare(driver, "stages", ".charts")
        planes(driver, check)
        defects(driver, check)
        driver.run("window.lumenfabView.show(Math.floor(document.querySelectorAll('#gallery figure').length / 2))")
        look(driver, "viewer", folder, "#browser")
        golden.compare(driver, "plane", "#view")
        layers(driver, check)
        measure(driver, check)
        driver.keys(["+", "+", "+"])
        look(driver, "measured", folder, "#browser")
        driver.keys(["m", "0"])
        model(driver, check, folder)
        if driver.run("return !!document.getElementById('unrolled')"):
            look(driver, "maps", folder, "#unrolled")
            golden.compare(driver, "maps", ".maps")
        look(driver, "stages", folder, "#stages")
        look(driver, "table", folder, "#figures")
        scrub(driver, check, least)
        narrow(driver, check)
        outside(driver, check)
    finally:
        driver.close()


def on_paper(page, folder, check):
    target = folder / "printed.pdf"
    target.unlink(missing_ok=True)
    command = ["chromium", "--headless=new", "--no-sandbox", f"--print-to-pdf={target}", page.resolve().as_uri()]
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=180, check=False)
    size = target.stat().st_size if target.exists() else 0
    check("it prints", size > 10_000, f"{size} bytes")
    n_planes = page.read_text().count("<figure data-plane=")
    if shutil.which("pdfinfo") and size:
        told = subprocess.run(["pdfinfo", target], capture_output=True, text=True, check=True).stdout
        n_pages = int(next(line.split()[1] for line in told.splitlines() if line.startswith("Pages:")))
        # Six planes a page, and what stands before and behind them.
        check("it prints on few pages", n_pages <= n_planes / 6 + 16, f"{n_pages} pages, {n_planes} planes")
    if shutil.which("pdftotext") and size:
        text = subprocess.run(["pdftotext", target, "-"], capture_output=True, text=True, check=True).stdout
        limits = "What this comparison cannot see" in text and "Compare the orientation letters" in text
        check("what it cannot see is on paper, too", limits)


def without_script(page, folder, check):
    driver = Driver(script=False)
    try:
        driver.open(page)
        driver.picture(folder / "no-script.png")
        shown = driver.call("POST", "/element", {"using": "css selector", "value": "#gallery figure svg"})
        size = driver.call("GET", f"/element/{next(iter(shown.values()))}/rect")
        check("without a script the pictures of all planes are shown", size["width"] > 100 and size["height"] > 100)
    finally:
        driver.close()


def main():
    if not (shutil.which("chromedriver") and shutil.which("chromium")):
        print("skipped: chromium or chromedriver is not installed")
        return 0
    options = argparse.ArgumentParser()
    options.add_argument("report", type=pathlib.Path)
    options.add_argument("--screenshots", type=pathlib.Path)
    options.add_argument("--golden", type=pathlib.Path)
    options.add_argument("--keep", action="store_true")
    options.add_argument("--planes-per-s", type=float)
    options = options.parse_args()
    report = options.report
    with tempfile.TemporaryDirectory() as own:
        folder = options.screenshots or pathlib.Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        # A copy of the page alone: nothing beside it may be needed.
        page = pathlib.Path(own) / "index.html"
        shutil.copy(report / "index.html", page)
        size = page.stat().st_size
        check = Checks()
        check("the page is at most 15 MB", size <= 15e6, f"{size / 1e6:.1f} MB")
        with_script(page, folder, check, Golden(options.golden, options.keep, check), options.planes_per_s)
        on_paper(page, folder, check)
        without_script(page, folder, check)
    return 1 if check.failed else 0


if __name__ == "__main__":
    sys.exit(main())

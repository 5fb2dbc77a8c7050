"""Printer hosts side by side on the simulated printer: lumenfab, Printrun's printcore, OctoPrint.

    pip install OctoPrint && pip install --no-deps Printrun pyserial
    cargo build --release --bins
    python tests/bench/hosts.py [--baud N,N] [--hosts lumenfab,printrun,octoprint] [--seconds S] [--job JOB.gcode]

Three tables, every host on the same printer (`hil-sim`, real time) in the same run; a host that is not installed is said to be.

1. Share of the wire that is used, at several rates, each answer 1 ms late: moves of no length, so that nothing but the wire limits.
   Measured by the printer's own record: bytes of the lines in the middle of the job by the time they took.
2. Without a wire (a pseudo-terminal as fast as it goes): lines a second, measured likewise; CPU seconds for 100,000 lines (of
   OctoPrint without the start of its server, of the others with their start), most memory.
3. With `--job` (as `lumenfab slice` writes it): the printer's planner while it prints: least depth and seconds without a move.
"""

import argparse
import importlib.util
import http.client
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BITS_PER_BYTE = 10
LINE = "G1 X0.0000 Y0.00000 E0.00000"
KEY = "0123456789ABCDEF0123456789ABCDEF"
OCTOPRINT_PORT = 5123

PRINTCORE = """
import sys, time
from printrun import gcoder
from printrun.printcore import printcore
port, baud, job = sys.argv[1], int(sys.argv[2]), sys.argv[3]
core = printcore()
core.loud = False
core.connect(port, baud)
began = time.time()
while not core.online:
    if time.time() - began > 20:
        sys.exit("never online")
    time.sleep(0.05)
core.startprint(gcoder.LightGCode([line.strip() for line in open(job)]))
while core.printing:
    time.sleep(0.02)
time.sleep(1)
core.disconnect()
"""


class Lumenfab:
    name = "lumenfab"

    def missing(self):
        return None if (ROOT / "target/release/lumenfab").exists() else "not built"

    def print(self, port, baud, job):
        command = [ROOT / "target/release/lumenfab", "print", job, "--port", port, "--profile", "marlin", "--baud", str(baud)]
        return used_by(command)


class Printrun:
    name = "printrun"

    def missing(self):
        return None if importlib.util.find_spec("printrun") else "not installed"

    def print(self, port, baud, job):
        return used_by([sys.executable, "-c", PRINTCORE, port, str(baud), job])


class OctoPrint:
    name = "octoprint"

    def missing(self):
        return None if importlib.util.find_spec("octoprint") else "not installed"

    def print(self, port, baud, job):
        with tempfile.TemporaryDirectory() as home:
            write_octoprint_settings(Path(home), port, baud)
            command = [sys.executable, "-m", "octoprint", "serve", "--basedir", home, "--iknowwhatimdoing"]
            server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                wait_for(lambda: self.ask("version"), 90)
                started = cpu_and_memory(server.pid)
                self.ask("connection", {"command": "connect", "port": port, "baudrate": baud})
                wait_for(lambda: self.state() == "Operational", 60)
                self.upload(job)
                wait_for(lambda: self.state() == "Operational", 36000)
                ended = cpu_and_memory(server.pid)
                self.ask("connection", {"command": "disconnect"})
                time.sleep(1)
            finally:
                server.terminate()
                server.wait()
        return ended[0] - started[0], ended[1]

    def state(self):
        answer = self.ask("connection")
        return answer and answer["current"]["state"]

    def ask(self, what, body=None):
        data = json.dumps(body).encode() if body else None
        headers = {"X-Api-Key": KEY, "Content-Type": "application/json"}
        request = urllib.request.Request(f"http://127.0.0.1:{OCTOPRINT_PORT}/api/{what}", data, headers)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return json.loads(answer.read() or b"{}")
        except (OSError, http.client.HTTPException):
            return None

    def upload(self, job):
        """Uploads and prints; returns when the print has begun."""
        edge = "----job"
        part = f'--{edge}\r\nContent-Disposition: form-data; name="file"; filename="job.gcode"\r\n\r\n'
        parts = part + Path(job).read_text() + f'\r\n--{edge}\r\nContent-Disposition: form-data; name="print"\r\n\r\ntrue\r\n--{edge}--\r\n'
        headers = {"X-Api-Key": KEY, "Content-Type": f"multipart/form-data; boundary={edge}"}
        url = f"http://127.0.0.1:{OCTOPRINT_PORT}/api/files/local"
        urllib.request.urlopen(urllib.request.Request(url, parts.encode(), headers), timeout=60).read()
        wait_for(lambda: self.state() != "Operational", 60)


def write_octoprint_settings(home, port, baud):
    """A server without anything that a print does not need."""
    (home / "config.yaml").write_text(
        f"""
server: {{firstRun: false, host: 127.0.0.1, port: {OCTOPRINT_PORT}, onlineCheck: {{enabled: false}}, pluginBlacklist: {{enabled: false}}}}
api: {{key: {KEY}}}
serial: {{additionalPorts: ["{port}"], additionalBaudrates: [{baud}], log: false, autoconnect: false}}
plugins: {{_disabled: [tracking, softwareupdate, announcements, pluginmanager, discovery, errortracking, gcodeviewer, backup]}}
gcodeAnalysis: {{runAt: never}}
accessControl: {{salt: salt}}
"""
    )


def used_by(command):
    """CPU seconds and most memory in MB of a command, by looking at it: `wait4` counts this program's own memory before `exec` as well."""
    mb = 0.0
    with tempfile.TemporaryFile("w+") as words:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=words)
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            mb = max(mb, most_memory(process.pid))
            time.sleep(0.02)
        if status:
            words.seek(0)
            raise RuntimeError(words.read()[-300:])
    return usage.ru_utime + usage.ru_stime, mb


def most_memory(pid):
    """MB; 0 of a process that has just ended."""
    peak = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(peak[1]) / 1024 if peak else 0.0


def cpu_and_memory(pid):
    stat = Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()
    return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK"), most_memory(pid)


def wait_for(is_true, seconds):
    until = time.time() + seconds
    while not is_true():
        if time.time() > until:
            raise RuntimeError("waited in vain")
        time.sleep(0.2)


def printed(host, job, baud, options):
    """Prints a job on a new printer: its record of commands, its summary, the host's CPU seconds and MB."""
    with tempfile.TemporaryDirectory() as folder:
        link, record = Path(folder) / "port", Path(folder) / "record"
        command = [ROOT / "target/release/hil-sim", "--profile", "marlin", "--link", link, "--record", record, "--speed", "realtime", *options]
        printer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            wait_for(link.exists, 10)
            cpu_s, mb = host.print(str(link), baud, str(job))
        finally:
            printer.terminate()
            printer.wait()
        commands = []
        for line in open(record / "events.jsonl", encoding="utf-8"):
            if '"event":"command"' in line:
                event = json.loads(line)
                commands.append((event["t_s"], event["text"]))
        return commands, json.loads((record / "summary.json").read_text()), cpu_s, mb


def middle(commands):
    """The lines of the job's middle: bytes on the wire, lines, seconds."""
    of_job = [(t, text) for t, text in commands if "G1 X0" in text]
    part = of_job[len(of_job) // 5 : -len(of_job) // 20]
    n_bytes = sum(len(text) + 1 for _, text in part[1:])
    return n_bytes, len(part) - 1, part[-1][0] - part[0][0]


def write_job(folder, n_lines):
    job = Path(folder) / "job.gcode"
    job.write_text((LINE + "\n") * n_lines)
    return job


def table_of_the_wire(hosts, bauds, seconds):
    print(f"{'share of the wire':<20}" + "".join(f"{baud:>12}" for baud in bauds))
    with tempfile.TemporaryDirectory() as folder:
        for host in hosts:
            cells = []
            for baud in bauds:
                job = write_job(folder, int(seconds * baud / BITS_PER_BYTE / 42))
                late = ["--fault", "delay:dir=tx,rate=1,for-s=0.001"]
                try:
                    commands, *_ = printed(host, job, baud, ["--baud", str(baud), *late])
                    n_bytes, _, elapsed_s = middle(commands)
                    cells.append(f"{n_bytes * BITS_PER_BYTE / baud / elapsed_s:>12.4f}")
                except (RuntimeError, OSError) as error:
                    cells.append(f"{'failed':>12}")
                    print(f"{host.name}, {baud} baud: {error}", file=sys.stderr)
            print(f"{host.name:<20}" + "".join(cells), flush=True)


def table_without_a_wire(hosts, n_lines):
    print(f"\n{'without a wire':<20}{'lines/s':>12}{'CPU s/100,000':>16}{'MB':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for host in hosts:
            # Some hosts take minutes for a hundred thousand.
            n = n_lines if host.name == "lumenfab" else n_lines // 20
            job = write_job(folder, n)
            commands, _, cpu_s, mb = printed(host, job, 115200, [])
            n_sent = sum("G1 X0" in text for _, text in commands)
            if n_sent != n:
                raise RuntimeError(f"{host.name} sent {n_sent} of {n}")
            _, lines, elapsed_s = middle(commands)
            print(f"{host.name:<20}{lines / elapsed_s:>12.0f}{cpu_s / n * 1e5:>16.2f}{mb:>8.0f}", flush=True)


def table_of_the_planner(hosts, job, baud):
    print(f"\n{'planner, ' + str(baud) + ' baud':<20}{'least depth':>12}{'dry, s':>10}{'times':>8}{'moving, s':>12}")
    for host in hosts:
        _, summary, *_ = printed(host, job, baud, ["--baud", str(baud)])
        figures = [summary[key] for key in ("least_planner_depth", "planner_dry_s", "planner_dry", "moving_s")]
        print(f"{host.name:<20}{figures[0]:>12}{figures[1]:>10.2f}{figures[2]:>8}{figures[3]:>12.1f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--baud", default="115200,250000,500000,1000000")
    parser.add_argument("--hosts", default="lumenfab,printrun,octoprint")
    parser.add_argument("--seconds", type=float, default=15, help="of wire for each figure of the first table")
    parser.add_argument("--lines", type=int, default=200_000, help="lines of the second table")
    parser.add_argument("--job", type=Path, help="G-code for the third table")
    given = parser.parse_args()
    known = {host.name: host for host in (Lumenfab(), Printrun(), OctoPrint())}
    hosts = []
    for name in given.hosts.split(","):
        why = known[name].missing()
        if why:
            print(f"{name}: {why}, left out")
        else:
            hosts.append(known[name])
    bauds = [int(baud) for baud in given.baud.split(",")]
    table_of_the_wire(hosts, bauds, given.seconds)
    table_without_a_wire(hosts, given.lines)
    if given.job:
        table_of_the_planner(hosts, given.job, bauds[0])


if __name__ == "__main__":
    main()

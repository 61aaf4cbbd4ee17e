#!/usr/bin/env python3
"""The service under systemd, in the guest of tests/systemd/run: started with the machine, ready, watched, restarted,
stopped, and kept in its sandbox. The processor is emulated: order and outcome are asserted, not times."""

import ctypes
import grp
import http.client
import json
import os
import pathlib
import pwd
import signal
import socket
import stat
import subprocess
import sys
import time
import unittest

UNIT = "omnihdrd.service"
DROP_IN = pathlib.Path("/etc/omnihdr/omnihdr.d/test.toml")
SESSIONS = pathlib.Path("/var/lib/omnihdr/sessions")
SOCKET = "/run/omnihdr/api.sock"
# Small pictures of a simulated drive, one a trigger, and no views. The machine starts with it.
SMALL = pathlib.Path("/test/small.toml").read_text(encoding="utf-8")


def run(*command, check=True, timeout=180):
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)
    if check and done.returncode != 0:
        raise AssertionError(f"{' '.join(command)}: {done.returncode}\n{done.stdout}{done.stderr}\n{log()}")
    return done


def systemctl(*arguments, **options):
    return run("systemctl", *arguments, **options)


def properties(*names, unit=UNIT):
    shown = systemctl("show", "--property=" + ",".join(names), unit).stdout
    return dict(line.split("=", 1) for line in shown.splitlines())


def log():
    return run("journalctl", "--unit=" + UNIT, "--no-pager", "--lines=25", "--output=cat", check=False).stdout


def eventually(holds, timeout=90):
    """Whether it holds within so many seconds; what it answered."""
    deadline = time.monotonic() + timeout
    while True:
        answer = holds()
        if answer or time.monotonic() > deadline:
            return answer
        time.sleep(0.2)


class Connection(http.client.HTTPConnection):
    def __init__(self):
        super().__init__("localhost", timeout=30)

    def connect(self):
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.settimeout(self.timeout)
        self.sock.connect(SOCKET)


def api(method, route):
    """(status code, JSON), or None when nobody answers."""
    connection = Connection()
    try:
        connection.request(method, route, body="{}" if method == "POST" else None)
        response = connection.getresponse()
        return response.status, json.loads(response.read() or b"null")
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


def status():
    answer = api("GET", "/v1/status")
    return answer[1] if answer else {}


def journal():
    file = SESSIONS / "survey/frames.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [json.loads(line) for line in lines]


class Service(unittest.TestCase):
    maxDiff = None
    probed = None

    @classmethod
    def setUpClass(cls):
        # A case may be run alone: the machine has started when the service has.
        eventually(lambda: properties("ActiveState")["ActiveState"] == "active")

    def configure(self, text):
        DROP_IN.write_text(text, encoding="utf-8")

    def pid(self):
        return int(properties("MainPID")["MainPID"])

    def restarted(self, old):
        """The new process, when another one runs and is ready."""
        shown = properties("MainPID", "ActiveState")
        new = int(shown["MainPID"])
        return new if new not in (0, old) and shown["ActiveState"] == "active" else 0

    def take(self):
        """A trigger by command, and its line in the journal."""
        before = len(journal())
        self.assertTrue(eventually(lambda: (api("POST", "/v1/trigger") or [0])[0] == 200), log())
        self.assertTrue(eventually(lambda: len(journal()) > before), log())

    def probe(self):
        """What a copy of the unit says that runs probe.py instead of the daemon."""
        unit = pathlib.Path("/usr/lib/systemd/system", UNIT).read_text(encoding="utf-8")
        for old, new in (("Type=notify", "Type=oneshot"), ("User=omnihdr", "User=root"), ("Group=omnihdr", "Group=root"),
                         ("Restart=on-failure", "Restart=no"),
                         ("ExecStart=/usr/bin/omnihdrd --config /etc/omnihdr/omnihdr.toml",
                          "ExecStart=/usr/bin/python3 -B /test/probe.py\nStandardOutput=file:/probe.txt")):
            self.assertIn(old, unit)
            unit = unit.replace(old, new)
        # The runtime directory stays the service's.
        unit = unit.replace("RuntimeDirectory=omnihdr", "RuntimeDirectory=probe")
        unit = unit.replace("StateDirectory=omnihdr omnihdr/sessions", "StateDirectory=probe")
        pathlib.Path("/etc/systemd/system/probe.service").write_text(unit, encoding="utf-8")
        os.makedirs("/srv/omnihdr", exist_ok=True)
        chip = pathlib.Path("/sys/kernel/config/gpio-sim/probe")
        (chip / "bank0").mkdir(parents=True)
        (chip / "live").write_text("1", encoding="utf-8")
        self.assertTrue(eventually(lambda: grp.getgrgid(os.stat("/dev/gpiochip0").st_gid).gr_name == "gpio"))
        self.assertEqual(stat.S_IMODE(os.stat("/dev/gpiochip0").st_mode), 0o660)
        systemctl("daemon-reload")
        systemctl("start", "probe.service")
        (chip / "live").write_text("0", encoding="utf-8")
        return dict(line.rsplit(": ", 1) for line in
                    pathlib.Path("/probe.txt").read_text(encoding="utf-8").splitlines())

    def test_it_is_started_with_the_machine(self):
        self.assertTrue(eventually(lambda: properties("ActiveState")["ActiveState"] == "active"), log())
        self.assertEqual(properties("UnitFileState", "NRestarts"), {"UnitFileState": "enabled", "NRestarts": "0"})

    def test_it_runs_as_its_user_in_its_groups_without_any_privilege(self):
        facts = dict(line.split(":", 1) for line in
                     pathlib.Path(f"/proc/{self.pid()}/status").read_text(encoding="utf-8").splitlines())
        user = pwd.getpwnam("omnihdr")
        self.assertEqual(set(facts["Uid"].split()), {str(user.pw_uid)})
        self.assertEqual(set(facts["Gid"].split()), {str(user.pw_gid)})
        groups = {grp.getgrgid(int(number)).gr_name for number in facts["Groups"].split()}
        self.assertEqual({"omnihdr", "video", "plugdev", "dialout", "gpio"}, groups | {"omnihdr"})
        for kind in ("CapEff", "CapPrm", "CapBnd", "CapAmb"):
            self.assertEqual(int(facts[kind], 16), 0, kind)
        self.assertEqual((facts["NoNewPrivs"].strip(), facts["Seccomp"].strip()), ("1", "2"))
        self.assertEqual(pathlib.Path(f"/proc/{self.pid()}/oom_score_adj").read_text(encoding="utf-8").strip(), "-500")

    def test_its_directories_belong_to_it_and_others_do_not_look_in(self):
        for path in (SESSIONS, SESSIONS.parent, pathlib.Path("/run/omnihdr")):
            facts = path.stat()
            self.assertEqual((pwd.getpwuid(facts.st_uid).pw_name, oct(stat.S_IMODE(facts.st_mode))),
                             ("omnihdr", "0o750"), path)
        self.assertTrue(eventually(lambda: os.path.exists(SOCKET)), log())
        facts = os.stat(SOCKET)
        self.assertEqual((grp.getgrgid(facts.st_gid).gr_name, oct(stat.S_IMODE(facts.st_mode))), ("omnihdr", "0o660"))

    def test_a_crash_costs_no_picture_and_the_session_goes_on(self):
        self.take()
        self.take()
        old = self.pid()
        os.kill(old, signal.SIGKILL)
        self.assertTrue(eventually(lambda: self.restarted(old)), log())
        self.assertEqual(properties("NRestarts")["NRestarts"], "1")
        self.take()
        self.assertEqual([line["frame"] for line in journal()], [0, 1, 2])
        self.assertEqual(pwd.getpwuid((SESSIONS / "survey/raw/000002.png").stat().st_uid).pw_name, "omnihdr")

    def test_a_reload_changes_what_may_change_or_is_refused_and_the_survey_goes_on(self):
        old = self.pid()
        self.configure(SMALL + '[log]\nlevel = "debug"\n')
        systemctl("reload", UNIT)
        self.assertIn("log.level", log())
        self.configure("[recorder]\nqueue_frames = 0\n")
        self.assertNotEqual(systemctl("reload", UNIT, check=False).returncode, 0)
        self.assertIn("recorder.queue_frames", log())
        self.configure(SMALL)
        self.assertEqual((self.pid(), properties("ActiveState")["ActiveState"]), (old, "active"))

    def test_a_stage_that_is_stuck_is_killed_by_the_watchdog_and_the_service_comes_back(self):
        old = self.pid()
        # Threads that a stage makes have its name, too: the stage is the oldest.
        named = [int(task.name) for task in pathlib.Path(f"/proc/{old}/task").iterdir()
                 if pathlib.Path(task, "comm").read_text(encoding="utf-8").strip() == "camera"]
        freezer = freeze(min(named))
        try:
            # The others live on: what is stuck is one stage of several.
            self.assertTrue(status(), log())
            Service.probed = self.probe()  # while it lasts
            new = eventually(lambda: self.restarted(old), timeout=120)
        finally:
            os.kill(freezer, signal.SIGKILL)
            os.waitpid(freezer, 0)
        said = run("journalctl", "--unit=" + UNIT, "--no-pager", "--output=cat").stdout
        self.assertTrue(new, said)
        # Who was stuck is in the log unless the frozen thread holds what the log or the main loop wants.
        self.assertIn("Watchdog timeout", said)
        self.assertIn("status=6/ABRT", said)

    def test_the_sandbox_lets_cameras_and_lines_through_and_nothing_else(self):
        self.assertEqual(Service.probed or self.probe(), {
            "/dev/null": "allowed", "/dev/gpiochip0": "allowed", "/dev/bus/usb/001/001": "allowed",
            "/dev/ttyS0": "allowed", "/dev/mem": "EPERM", "/dev/hpet": "EPERM", "/dev/port": "EPERM",
            # Of the number of the serial ports; it belongs to a group that the user is not in.
            "/dev/tty0": "allowed",
            "write /etc": "EROFS", "write /usr": "EROFS", "write /var/lib": "EROFS",
            "write /srv/omnihdr": "allowed", "write /proc/sys": "EROFS", "look into /home": "EACCES",
            "executable memory": "EPERM", "packet socket": "EAFNOSUPPORT", "netlink socket": "allowed",
            "namespace": "EPERM", "mount": "EPERM", "real time 20": "allowed", "real time 21": "EPERM",
            "lowest priority": "allowed"})

    def test_a_stop_is_clean_and_leaves_the_session_open(self):
        systemctl("stop", UNIT)
        self.assertEqual(properties("ActiveState", "Result", "ExecMainStatus"),
                         {"ActiveState": "inactive", "Result": "success", "ExecMainStatus": "0"})
        self.assertFalse(os.path.exists(SOCKET))
        self.assertEqual([line["status"] for line in journal()], ["ok"] * len(journal()))
        self.assertFalse((SESSIONS / "survey/ended.json").exists())

    def test_a_start_returns_when_the_socket_answers_though_the_camera_is_not_ready(self):
        # The simulated vehicle takes long to open here.
        self.configure(SMALL.replace('name = "survey"', 'name = "vehicle"').replace('"replay"', '"sim"'))
        systemctl("restart", UNIT)
        self.assertIn("version", status())

    def test_a_wrong_configuration_ends_with_78_and_is_not_tried_again(self):
        systemctl("stop", UNIT)
        self.configure("[recorder]\nqueue_frames = 0\n")
        self.assertNotEqual(systemctl("start", UNIT, check=False).returncode, 0)
        time.sleep(6)  # three times RestartSec
        self.assertEqual(properties("ActiveState", "ExecMainStatus", "NRestarts"),
                         {"ActiveState": "failed", "ExecMainStatus": "78", "NRestarts": "0"})
        self.assertIn("recorder.queue_frames", log())
        systemctl("reset-failed", UNIT)

    def test_without_its_survey_volume_it_does_not_start(self):
        systemctl("stop", UNIT)
        mount = pathlib.Path("/etc/systemd/system/srv-omnihdr.mount")
        mount.write_text("[Mount]\nWhat=none\nWhere=/srv/omnihdr\nType=nosuchtype\n", encoding="utf-8")
        systemctl("daemon-reload")
        try:
            self.configure(SMALL)
            self.assertNotEqual(systemctl("start", UNIT, check=False).returncode, 0)
            self.assertEqual(properties("ActiveState")["ActiveState"], "inactive")
        finally:
            mount.unlink()
            systemctl("daemon-reload")

    def test_a_camera_that_is_plugged_in_starts_it_and_is_used(self):
        systemctl("stop", UNIT)
        self.configure(SMALL.replace('name = "survey"', 'name = "head"').replace('"replay"', '"iidc"')
                       + '[camera.iidc]\nrig = "/etc/omnihdr/head.toml"\n')
        with subprocess.Popen(["/test/plugged_camera", "/etc/omnihdr/head.toml"]) as camera:
            try:
                self.assertTrue(eventually(lambda: properties("ActiveState")["ActiveState"] == "active"), log())
                self.assertTrue(eventually(lambda: status().get("camera", {}).get("ready")), log())
                nodes = [node.stat() for node in pathlib.Path("/dev/bus/usb").glob("*/*")
                         if grp.getgrgid(node.stat().st_gid).gr_name == "plugdev"]
                self.assertEqual([oct(stat.S_IMODE(facts.st_mode)) for facts in nodes], ["0o660"])
                self.assertEqual([link.name for link in pathlib.Path("/dev/omnihdr").iterdir()], ["camera-00C0FFEE"])
            finally:
                camera.kill()
        self.assertTrue(eventually(lambda: status().get("camera", {}).get("ready") is False), log())
        self.assertEqual(properties("ActiveState")["ActiveState"], "active")

    def test_tcp_is_served_to_whoever_has_the_token_of_the_credential(self):
        systemctl("stop", UNIT)
        self.configure(SMALL + '[api]\ntcp = "127.0.0.1:8787"\n')
        # Without a token there is no TCP, and no start.
        self.assertNotEqual(systemctl("start", UNIT, check=False).returncode, 0)
        self.assertIn("api-token", log())
        systemctl("stop", UNIT)
        systemctl("reset-failed", UNIT)
        token = pathlib.Path("/etc/omnihdr/token")
        token.write_text("0123456789abcdef0123456789abcdef\n", encoding="utf-8")
        token.chmod(0o600)  # root's alone: systemd hands it to the service
        drop_in = pathlib.Path("/etc/systemd/system/omnihdrd.service.d/token.conf")
        drop_in.write_text(f"[Service]\nLoadCredential=api-token:{token}\n", encoding="utf-8")
        systemctl("daemon-reload")
        systemctl("start", UNIT)

        def asked(headers):
            connection = http.client.HTTPConnection("127.0.0.1", 8787, timeout=30)
            try:
                connection.request("GET", "/v1/status", headers=headers)
                return connection.getresponse().status
            finally:
                connection.close()

        self.assertEqual([asked({}), asked({"Authorization": "Bearer 0123456789abcdef0123456789abcdeX"}),
                          asked({"Authorization": "Bearer 0123456789abcdef0123456789abcdef"})], [401, 401, 200])
        listening = pathlib.Path("/proc/net/tcp").read_text(encoding="utf-8").splitlines()[1:]
        self.assertEqual([line.split()[1] for line in listening if line.split()[3] == "0A" and
                          line.split()[1].endswith(":2253")], ["0100007F:2253"])  # loopback alone, in the kernel's hex


def freeze(thread):
    """Stops one thread alone, as a call that does not return would; the process that holds it."""
    child = os.fork()
    if child:
        return child
    libc = ctypes.CDLL(None, use_errno=True)
    seize, interrupt, any_child = 0x4206, 0x4207, 0x40000000
    if libc.ptrace(seize, thread, None, None) or libc.ptrace(interrupt, thread, None, None):
        os._exit(1)
    while True:  # until it is killed: then it must be taken leave of
        _, ended = os.waitpid(thread, any_child)
        if os.WIFEXITED(ended) or os.WIFSIGNALED(ended):
            os._exit(0)


class Told(unittest.TextTestResult):
    """Says at once what is wrong: the guest may be ended before its end."""

    def addFailure(self, test, err):
        super().addFailure(test, err)
        self.stream.writeln(self.failures[-1][1])

    def addError(self, test, err):
        super().addError(test, err)
        self.stream.writeln(self.errors[-1][1])


def by_line(one, other):
    lines = [getattr(Service, name).__code__.co_firstlineno for name in (one, other)]
    return lines[0] - lines[1]


if __name__ == "__main__":
    loader = unittest.TestLoader()
    loader.sortTestMethodsUsing = by_line
    sys.exit(unittest.main(testLoader=loader, testRunner=unittest.TextTestRunner(verbosity=2, resultclass=Told)))

#!/usr/bin/env python3
"""The files of systemd/ say what a daemon with hardware needs: unit, device rules, user, limits.

Needs no systemd; what systemd itself says of the files is asked where it is installed (version 252 or later)."""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

TOP = pathlib.Path(__file__).resolve().parents[2]
SYSTEMD = TOP / "systemd"
# What "systemd-analyze security" gives the unit, from 0 (locked up) to 10; our own bound.
HIGHEST_EXPOSURE = 1.8


def unit_lines():
    """{section: [(key, value)]} of the unit, in order."""
    sections, section = {}, None
    for line in (SYSTEMD / "omnihdrd.service").read_text(encoding="utf-8").splitlines():
        if not line or line[0] in "#;":
            continue
        if line.startswith("["):
            section = sections.setdefault(line[1:-1], [])
        else:
            key, value = line.split("=", 1)
            section.append((key, value))
    return sections


UNIT = unit_lines()


def all_of(key, section="Service"):
    return [value for name, value in UNIT[section] if name == key]


def words_of(key, section="Service"):
    return " ".join(all_of(key, section)).split()


def settings(name):
    """The lines of a file that say something."""
    lines = (SYSTEMD / name).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def seconds(value):
    match = re.fullmatch(r"(\d+)(s|min)?", value)
    return int(match.group(1)) * (60 if match.group(2) == "min" else 1)


class Unit(unittest.TestCase):
    def one(self, key, section="Service"):
        values = all_of(key, section)
        self.assertEqual(len(values), 1, f"{key}= in [{section}]")
        return values[0]

    def test_it_is_ready_when_the_daemon_says_so_and_only_the_daemon(self):
        self.assertEqual(self.one("Type"), "notify")
        self.assertEqual(self.one("NotifyAccess"), "main")

    def test_a_start_that_reads_a_long_journal_is_waited_for(self):
        self.assertGreaterEqual(seconds(self.one("TimeoutStartSec")), 90)

    def test_the_watchdog_watches_and_its_signal_is_the_one_that_leaves_a_core(self):
        self.assertLessEqual(seconds(self.one("WatchdogSec")), 30)
        self.assertEqual(all_of("WatchdogSignal"), [])

    def test_it_is_started_again_for_ever_but_not_with_a_wrong_configuration_or_command_line(self):
        self.assertEqual(self.one("Restart"), "on-failure")
        self.assertEqual(self.one("RestartSec"), "2")
        self.assertLessEqual({"64", "78"}, set(words_of("RestartPreventExitStatus")))
        self.assertEqual(self.one("StartLimitIntervalSec", "Unit"), "0")

    def test_a_stop_has_the_time_that_the_daemon_takes_for_it(self):
        grace = re.search(r"kPipelineGrace = seconds\((\d+)\)",
                          (TOP / "daemon/app.cc").read_text(encoding="utf-8"))
        self.assertGreater(seconds(self.one("TimeoutStopSec")), int(grace.group(1)) + 10)
        self.assertEqual(all_of("KillMode"), [])
        self.assertEqual(all_of("KillSignal"), [])

    def test_an_absent_camera_is_reported_from_the_start_and_none_is_waited_for_by_the_unit(self):
        self.assertEqual(self.one("WantedBy", "Install"), "multi-user.target")
        for key, _ in UNIT["Unit"] + UNIT["Service"]:
            self.assertNotRegex(key, r"^(Condition|Assert|ExecStartPre|BindsTo)")
        self.assertNotIn("systemd-udev-settle.service", words_of("After", "Unit"))

    def test_modules_are_not_loaded_by_it(self):
        self.assertEqual(self.one("ExecStart"), "/usr/bin/omnihdrd --config /etc/omnihdr/omnihdr.toml")
        self.assertIn("usbcore", settings("omnihdr.modules-load.conf"))

    def test_the_default_configuration_file_is_the_programs_own(self):
        header = (TOP / "daemon/config.h").read_text(encoding="utf-8")
        self.assertIn('kDefaultConfigFile = "/etc/omnihdr/omnihdr.toml"', " ".join(header.split()))

    def test_devices_are_allowed_by_class_and_no_others(self):
        self.assertEqual(self.one("DevicePolicy"), "closed")
        allowed = [value.split() for value in all_of("DeviceAllow")]
        for name, access in allowed:
            self.assertTrue(name.startswith("char-"), f"{name} is a node, whose number changes")
            self.assertEqual(access, "rw", name)
        self.assertLessEqual({"char-usb_device", "char-firewire", "char-video4linux", "char-gpiochip", "char-ttyUSB",
                              "char-ttyACM", "char-ttyS"}, {name for name, _ in allowed})

    def test_classes_that_come_with_a_module_are_there_before_the_start(self):
        # A class in DeviceAllow= that the kernel does not know at the start stays refused.
        self.assertLessEqual({"usbcore", "firewire_core", "videodev", "usbserial", "cdc_acm"},
                             set(settings("omnihdr.modules-load.conf")))
        self.assertNotIn("DefaultDependencies", dict(UNIT["Unit"]))  # sysinit.target, so modules, first

    def test_devices_their_groups_and_their_events_are_not_hidden(self):
        for key in ("PrivateDevices", "PrivateUsers", "PrivateNetwork"):
            self.assertEqual(self.one(key), "no")
        self.assertEqual(set(words_of("RestrictAddressFamilies")),
                         {"AF_UNIX", "AF_NETLINK", "AF_INET", "AF_INET6"})

    def test_it_runs_as_its_own_user_which_keeps_the_data(self):
        self.assertEqual(self.one("User"), "omnihdr")
        self.assertEqual(self.one("Group"), "omnihdr")
        self.assertEqual(all_of("DynamicUser"), [])
        # A group that is named in the unit and does not exist keeps it from starting.
        self.assertEqual(all_of("SupplementaryGroups"), [])

    def test_it_has_no_capability_and_gets_none(self):
        self.assertEqual(self.one("NoNewPrivileges"), "yes")
        self.assertEqual(self.one("CapabilityBoundingSet"), "")
        self.assertEqual(self.one("AmbientCapabilities"), "")

    def test_the_sandbox_is_closed_where_hardware_allows(self):
        self.assertEqual(self.one("ProtectSystem"), "strict")
        self.assertEqual(self.one("ProtectProc"), "invisible")
        for key in ("ProtectHome", "PrivateTmp", "PrivateMounts", "ProtectKernelTunables", "ProtectKernelModules",
                    "ProtectKernelLogs", "ProtectControlGroups", "ProtectClock", "ProtectHostname",
                    "RestrictNamespaces", "RestrictSUIDSGID", "LockPersonality", "MemoryDenyWriteExecute"):
            self.assertEqual(self.one(key), "yes", key)
        self.assertEqual(self.one("SystemCallArchitectures"), "native")
        self.assertEqual(all_of("SystemCallFilter"), ["@system-service", "~@privileged"])
        self.assertEqual(self.one("SystemCallErrorNumber"), "EPERM")

    def test_triggers_and_exposures_may_run_in_real_time_within_limits(self):
        self.assertEqual(self.one("RestrictRealtime"), "no")
        wanted = re.findall(r"k\w+ = (\d+)", (TOP / "core/base/realtime.h").read_text(encoding="utf-8"))
        self.assertEqual(int(self.one("LimitRTPRIO")), max(map(int, wanted)))
        self.assertLessEqual(int(self.one("LimitRTTIME")), 2_000_000)  # microseconds

    def test_its_directories_are_the_configurations_defaults(self):
        self.assertEqual(self.one("StateDirectory"), "omnihdr omnihdr/sessions")
        self.assertEqual(self.one("RuntimeDirectory"), "omnihdr")
        self.assertEqual(self.one("RuntimeDirectoryMode"), "0750")
        # It would make /etc/omnihdr writable in the sandbox; the package makes the directory.
        self.assertEqual(all_of("ConfigurationDirectory"), [])
        text = (TOP / "config/omnihdr.toml").read_text(encoding="utf-8")
        self.assertIn('directory = "/var/lib/omnihdr/sessions"', text)
        self.assertIn('socket = "/run/omnihdr/api.sock"', text)

    def test_a_survey_volume_is_there_before_it_is_written(self):
        mounts = words_of("RequiresMountsFor", "Unit")
        self.assertEqual(mounts, ["/var/lib/omnihdr/sessions", "/srv/omnihdr"])
        self.assertEqual(self.one("ReadWritePaths"), "-/srv/omnihdr")

    def test_its_share_of_the_machine_is_bounded_and_comes_first(self):
        self.assertEqual(self.one("UMask"), "0027")
        self.assertLess(int(self.one("Nice")), 0)
        self.assertLess(int(self.one("OOMScoreAdjust")), 0)
        self.assertEqual(self.one("IOSchedulingClass"), "best-effort")
        for key in ("MemoryHigh", "LimitMEMLOCK", "LimitNOFILE", "TasksMax"):
            self.one(key)
        self.assertEqual(all_of("CPUAffinity"), [])  # for the administrator

    def test_clock_and_gpsd_order_the_start_and_hold_up_nothing(self):
        after = words_of("After", "Unit")
        self.assertLessEqual({"local-fs.target", "time-sync.target", "gpsd.service"}, set(after))
        self.assertEqual(words_of("Requires", "Unit"), [])
        self.assertNotIn("time-sync.target", words_of("Wants", "Unit"))

    def test_nothing_is_set_twice_by_mistake(self):
        lists = {"DeviceAllow", "SystemCallFilter"}
        for section, lines in UNIT.items():
            keys = [key for key, _ in lines if key not in lists]
            self.assertEqual(sorted(keys), sorted(set(keys)), section)


class Systemd(unittest.TestCase):
    """What systemd's own tools say."""

    def setUp(self):
        if not shutil.which("systemd-analyze"):
            self.skipTest("systemd-analyze is not installed")

    def test_the_sandbox_leaves_little_exposed(self):
        done = subprocess.run(["systemd-analyze", "security", "--offline=true", "--no-pager",
                               SYSTEMD / "omnihdrd.service"],
                              capture_output=True, text=True, check=False, timeout=60)
        found = re.search(r"Overall exposure level for omnihdrd\.service: ([\d.]+)", done.stdout)
        self.assertTrue(found, done.stdout + done.stderr)
        self.assertLessEqual(float(found.group(1)), HIGHEST_EXPOSURE, done.stdout)

    def test_every_line_of_the_unit_is_understood(self):
        with tempfile.TemporaryDirectory() as folder:
            # Programs and manual pages need not be installed here.
            text = (SYSTEMD / "omnihdrd.service").read_text(encoding="utf-8")
            text = re.sub(r"(?m)^(ExecStart|ExecReload)=\S+", r"\1=/bin/true", text)
            text = re.sub(r"(?m)^Documentation=.*\n", "", text)
            unit = pathlib.Path(folder, "omnihdrd.service")
            unit.write_text(text, encoding="utf-8")
            done = subprocess.run(["systemd-analyze", "verify", "--man=no", unit],
                                  capture_output=True, text=True, check=False, timeout=60)
            ours = [line for line in done.stderr.splitlines() if "omnihdrd.service" in line]
            self.assertEqual((done.returncode, ours), (0, []))

    def test_the_user_can_be_made(self):
        with tempfile.TemporaryDirectory() as folder:
            pathlib.Path(folder, "etc").mkdir()
            for name in ("passwd", "group"):
                pathlib.Path(folder, "etc", name).write_text("", encoding="utf-8")
            subprocess.run(["systemd-sysusers", f"--root={folder}", SYSTEMD / "omnihdr.sysusers.conf"],
                           capture_output=True, check=True, timeout=60)
            user = pathlib.Path(folder, "etc/passwd").read_text(encoding="utf-8")
            self.assertRegex(user, r"(?m)^omnihdr:x:\d+:\d+:[^:]*:/var/lib/omnihdr:\S*nologin$")
            groups = pathlib.Path(folder, "etc/group").read_text(encoding="utf-8")
            for group in ("video", "plugdev", "dialout", "gpio"):
                self.assertRegex(groups, rf"(?m)^{group}:x:\d+:omnihdr$")


class Rules(unittest.TestCase):
    CAMERAS = settings("60-omnihdr-cameras.rules")

    def test_they_match_the_models_of_the_driver_and_no_others(self):
        table = (TOP / "drivers/iidc/model_table.cc").read_text(encoding="utf-8")
        models = {number.lower() for number in re.findall(r"\.product = 0x([0-9A-Fa-f]{4})", table)}
        products = [re.fullmatch(r'ATTR\{idProduct\}=="([0-9a-f|]+)", GOTO="omnihdr_camera"', line)
                    for line in self.CAMERAS if "idProduct" in line]
        matched = [number for match in products for number in match.group(1).split("|")]
        self.assertEqual(sorted(matched), sorted(models))
        self.assertIn('ATTR{idVendor}!="1e10", GOTO="omnihdr_cameras_end"', self.CAMERAS)

    def test_they_act_on_add_and_on_bind(self):
        # Every event but the last: a rule for "add" alone loses its properties at "bind".
        self.assertEqual([line for line in self.CAMERAS if "ACTION" in line],
                         ['ACTION=="remove", GOTO="omnihdr_cameras_end"'])

    def test_a_camera_starts_the_service_belongs_to_its_group_and_has_a_lasting_name(self):
        acting = self.CAMERAS[self.CAMERAS.index('LABEL="omnihdr_camera"') + 1]
        for part in ('GROUP="plugdev"', 'MODE="0660"', 'TAG+="systemd"',
                     'ENV{SYSTEMD_WANTS}+="omnihdrd.service"'):
            self.assertIn(part, acting)
        self.assertTrue(any('SYMLINK+="omnihdr/camera-$attr{serial}"' in line for line in self.CAMERAS))

    def test_the_firewire_controllers_own_node_is_opened_by_the_cameras_group(self):
        rule = 'SUBSYSTEM=="firewire", ATTR{is_local}=="1", GROUP="video", MODE="0660"'
        self.assertLess(self.CAMERAS.index(rule), self.CAMERAS.index('SUBSYSTEM!="usb", GOTO="omnihdr_cameras_end"'))

    def test_nobody_else_may_use_the_devices(self):
        for file in SYSTEMD.glob("*.rules"):
            self.assertRegex(file.name, r"^6[0-9]-")  # before 70-uaccess, after the built-in properties
            for line in settings(file.name):
                for mode in re.findall(r'MODE="(\d+)"', line):
                    self.assertEqual(mode, "0660", file.name)
                self.assertNotIn("uaccess", line)

    def test_every_jump_has_its_label(self):
        for file in SYSTEMD.glob("*.rules"):
            text = "\n".join(settings(file.name))
            self.assertEqual(set(re.findall(r'GOTO="(\w+)"', text)), set(re.findall(r'LABEL="(\w+)"', text)))

    def test_gpio_chips_belong_to_their_group(self):
        self.assertEqual(settings("60-omnihdr-gpio.rules"),
                         ['SUBSYSTEM=="gpio", KERNEL=="gpiochip[0-9]*", GROUP="gpio", MODE="0660"'])

    def test_their_groups_are_the_users(self):
        groups = {line.split()[2] for line in settings("omnihdr.sysusers.conf") if line.startswith("m ")}
        self.assertEqual(groups, {"video", "plugdev", "dialout", "gpio"})
        used = re.findall(r'GROUP="(\w+)"', "\n".join(self.CAMERAS + settings("60-omnihdr-gpio.rules")))
        self.assertLessEqual(set(used), groups)

    def test_udev_understands_them(self):
        tool = shutil.which("udevadm") or shutil.which("udevadm", path="/usr/bin:/bin:/usr/sbin:/sbin")
        if not tool or subprocess.run([tool, "verify", "--help"], capture_output=True, check=False).returncode:
            self.skipTest("udevadm verify is not there (udev 254 or later)")
        done = subprocess.run([tool, "verify", *sorted(SYSTEMD.glob("*.rules"))],
                              capture_output=True, text=True, check=False, timeout=60)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


class Limits(unittest.TestCase):
    def test_the_memory_for_usb_is_raised_whether_usbcore_is_a_module_or_not(self):
        module, = settings("omnihdr.modprobe.conf")
        written, = settings("omnihdr.tmpfiles.conf")
        megabytes = re.fullmatch(r"options usbcore usbfs_memory_mb=(\d+)", module).group(1)
        self.assertEqual(written.split(),
                         ["w-", "/sys/module/usbcore/parameters/usbfs_memory_mb", "-", "-", "-", "-", megabytes])
        self.assertGreaterEqual(int(megabytes), 64)


class Packaging(unittest.TestCase):
    DEBIAN = SYSTEMD / "debian"

    def test_an_update_neither_stops_nor_restarts_the_service(self):
        rules = (self.DEBIAN / "rules").read_text(encoding="utf-8")
        self.assertIn("dh_installsystemd --no-stop-on-upgrade --no-restart-after-upgrade", rules)

    def test_the_user_is_made_and_neither_it_nor_its_data_are_removed(self):
        self.assertIn("--with installsysusers", (self.DEBIAN / "rules").read_text(encoding="utf-8"))
        self.assertEqual(list(self.DEBIAN.glob("*.postrm")) + list(self.DEBIAN.glob("*.prerm")), [])
        self.assertNotRegex((self.DEBIAN / "omnihdr.postinst").read_text(encoding="utf-8"), r"\brm\b|deluser")

    def test_it_is_built_with_the_libraries_that_everything_else_is_built_with(self):
        listed = (TOP / "scripts/packages.txt").read_text(encoding="utf-8")
        libraries = re.search(r"(?ms)^\[libraries\]\n(.*?)\n\n", listed).group(1).split()
        done = subprocess.run([TOP / "scripts/package", "--control"], capture_output=True, text=True, check=True,
                              timeout=60)
        source = done.stdout.split("\n\n")[0]
        for library in libraries:
            self.assertIn(f"\n {library},", source)
        self.assertNotRegex(source, r"@[A-Z]+@")

    def test_its_scripts_can_be_read_by_a_shell(self):
        for script in (self.DEBIAN / "omnihdr.postinst", self.DEBIAN / "tests/simulated-drive",
                       TOP / "tests/systemd/package_test.sh"):
            subprocess.run(["sh", "-n", script], check=True, timeout=60)


if __name__ == "__main__":
    sys.exit(unittest.main())

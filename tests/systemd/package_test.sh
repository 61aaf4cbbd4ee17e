# In the guest of scripts/package --test, whose root is a clean Debian: the package's life, with a survey running.
# shellcheck shell=sh
export PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8
journal=/var/lib/omnihdr/sessions/survey/frames.jsonl

step() { echo "package: $*"; }
fail() {
  echo "package: FAILED: $*"
  systemctl status --no-pager --lines=20 omnihdrd.service
  exit 1
}
eventually() {  # COMMAND...: within two minutes
  for _ in $(seq 240); do
    "$@" && return 0
    sleep 0.5
  done
  return 1
}
pid() { systemctl show --property=MainPID --value omnihdrd.service; }
active() { [ "$(systemctl is-active omnihdrd.service)" = active ]; }
lines() { [ -f "$journal" ] && [ "$(wc -l <"$journal")" -ge "$1" ]; }
triggered() { omnihdr trigger >/dev/null 2>&1; }
take() {  # LINES: a picture, after which the journal has so many
  eventually triggered || fail "no trigger is taken"
  eventually lines "$1" || fail "the picture is not in the journal"
}

mkdir -p /etc/omnihdr/omnihdr.d
cat >/etc/omnihdr/omnihdr.d/survey.toml <<TOML
[session]
name = "survey"
[camera]
driver = "replay"
frame_timeout_s = 60.0
[camera.replay]
session = "/test/drive"
[trigger]
armed_at_start = true
[pipeline]
enabled = false
TOML

step "install"
dpkg -i /test/omnihdr.deb || fail "dpkg -i"
eventually active || fail "not started by the installation"
[ "$(systemctl is-enabled omnihdrd.service)" = enabled ] || fail "not enabled"
id omnihdr || fail "no user"
for group in video plugdev dialout gpio; do
  id -nG omnihdr | tr ' ' '\n' | grep -qx "$group" || fail "not in group $group"
done
take 1
take 2
[ "$(stat -c %U:%a "$journal")" = omnihdr:640 ] || fail "owner or mode of the journal: $(stat -c %U:%a "$journal")"

step "upgrade over the running survey"
echo '# of the administrator' >>/etc/omnihdr/omnihdr.toml
old="$(pid)"
dpkg -i /test/next.deb || fail "dpkg -i, the next version"
[ "$(pid)" = "$old" ] || fail "the upgrade ended the survey"
grep -q 'of the administrator' /etc/omnihdr/omnihdr.toml || fail "the upgrade changed the configuration"
take 3
systemctl restart omnihdrd.service || fail "restart"
[ "$(pid)" != "$old" ] || fail "not restarted"
take 4

step "remove"
dpkg -r omnihdr || fail "dpkg -r"
[ "$(systemctl is-active omnihdrd.service)" != active ] || fail "runs although it was removed"
[ -f /etc/omnihdr/omnihdr.toml ] || fail "removing took the configuration away"
lines 4 || fail "removing took data away"

step "purge"
dpkg -P omnihdr || fail "dpkg -P"
[ ! -e /etc/omnihdr/omnihdr.toml ] || fail "purging left the configuration"
lines 4 || fail "purging took data away"
[ "$(find /var/lib/omnihdr/sessions/survey/raw -name '*.png' | wc -l)" = 4 ] || fail "purging took pictures away"
[ "$(stat -c %U "$journal")" = omnihdr ] || fail "the data have lost their owner"
step "passed"

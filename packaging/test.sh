#!/usr/bin/env bash
# Builds the Debian package, or uses the named one, installs, tests and purges it. Needs cargo-deb. Installing needs
# root and dpkg, and is skipped without them.
#   packaging/test.sh [PACKAGE.deb]
set -euo pipefail
cd "$(dirname "$0")/.."

step() { printf '\n--- %s\n' "$*"; }
fail() { echo "FAILED: $*"; exit 1; }
skipped=
skip() { echo "skipped: $*"; skipped+=${skipped:+$'\n'}"skipped: $*"; }
# The tests that this machine could not run, listed at the end.
account() { echo; echo "${skipped:-nothing was skipped}"; }
trap account EXIT
# A need in CDCR_REQUIRE must not be missing: docs/testing.md.
need() { case ",${CDCR_REQUIRE:-}," in *",$1,"*) fail "CDCR_REQUIRE names $1: $2";; *) skip "$2";; esac; }

step "the list of third-party licences is that of Cargo.lock"
licences=$(cargo run --quiet --locked -p cdcr-packaging --bin third-party) || fail "the list cannot be made"
diff <(echo "$licences") packaging/generated/THIRD-PARTY \
  || fail "stale: cargo run -p cdcr-packaging --bin third-party > packaging/generated/THIRD-PARTY"

step "the unit"
if command -v systemd-analyze >/dev/null; then
  # The programs in the unit need not be installed here.
  root=$(mktemp -d)
  install -D /dev/null "$root/usr/bin/cdcrd"
  install -D /dev/null "$root/bin/sh"
  chmod 755 "$root/usr/bin/cdcrd" "$root/bin/sh"
  install -D -m 644 packaging/cdcrd.service "$root/usr/lib/systemd/system/cdcrd.service"
  for target in multi-user sysinit basic shutdown; do
    printf '[Unit]\nDescription=%s\n' "$target" > "$root/usr/lib/systemd/system/$target.target"
  done
  complaints=$(systemd-analyze verify --man=no --root="$root" "$root/usr/lib/systemd/system/cdcrd.service" 2>&1) \
    || fail "systemd-analyze verify: $complaints"
  [ -z "$complaints" ] || fail "systemd-analyze verify: $complaints"
  systemd-analyze security --offline=yes --threshold=20 --no-pager packaging/cdcrd.service | tail -n 1
  rm -r "$root"
else
  skip "systemd-analyze is not installed"
fi

step "the package"
package=${1:-}
if [ -z "$package" ]; then
  package=$(packaging/build.sh | tail -n 1)
fi
[ -f "$package" ] || fail "there is no package $package"
ls -l "$package"
if command -v lintian >/dev/null; then
  lintian "$package" || true
fi

if [ "$(id -u)" != 0 ]; then need root "installing it needs root"; exit 0; fi
if ! command -v dpkg >/dev/null; then skip "installing it needs dpkg"; exit 0; fi
if dpkg-query --show cdcr >/dev/null 2>&1; then skip "cdcr is installed here, and stays"; exit 0; fi
if ! command -v systemd-sysusers >/dev/null && ! command -v useradd >/dev/null; then skip "installing it needs systemd-sysusers or useradd"; exit 0; fi

had_user=$(getent passwd cdcr || true)
[ -z "$had_user" ] || fail "there is a user cdcr already: $had_user"
daemon=
clean_up() {
  if [ -n "$daemon" ]; then
    kill "$daemon" 2>/dev/null || true
    wait "$daemon" 2>/dev/null || true
  fi
  umount /run/cdcr 2>/dev/null || true
  dpkg --purge cdcr >/dev/null 2>&1 || true
  # Files made by the test, unknown to the package.
  rm -rf "${scratch:-}"
  account
}
trap clean_up EXIT

step "install"
dpkg --install "$package"
getent passwd cdcr | grep -q nologin || fail "no user cdcr without a login"
expect() { # mode owner file
  found=$(stat -c '%a %U:%G' "$3") || fail "$3 is missing"
  [ "$found" = "$1 $2" ] || fail "$3 is $found, not $1 $2"
}
for program in cdcrd cdcrctl cdcr-bench; do
  expect 755 root:root "/usr/bin/$program"
  "$program" --version
  expect 644 root:root "/usr/share/bash-completion/completions/$program"
  expect 644 root:root "/usr/share/zsh/vendor-completions/_$program"
  expect 644 root:root "/usr/share/fish/vendor_completions.d/$program.fish"
  bash -n "/usr/share/bash-completion/completions/$program"
done
for file in /etc/cdcr/cdcr.toml /etc/security/limits.d/cdcr.conf /usr/lib/systemd/system/cdcrd.service \
  /usr/lib/sysusers.d/cdcr.conf /usr/lib/udev/rules.d/60-cdcr.rules; do
  expect 644 root:root "$file"
done
dpkg-query --show --showformat='${Conffiles}\n' cdcr | grep -q /etc/cdcr/cdcr.toml || fail "the configuration is not a conffile"
# Read completely first: grep -q ends at its first match, and the writing dpkg would then fail the pipe.
files=$(dpkg --listfiles cdcr)
# An image without documentation leaves these out (dpkg's path-exclude).
if grep -qx '/usr/share/man/man8/cdcrd.8.gz' <<<"$files"; then
  if [ -e /usr/share/man/man8/cdcrd.8.gz ]; then
    if command -v man >/dev/null; then man -w cdcrd cdcrctl cdcrctl-ref-spiral cdcr-bench; else skip "man is not installed"; fi
  else
    skip "this system installs no manual pages"
  fi
else
  fail "the package has no manual page for cdcrd"
fi
for name in copyright THIRD-PARTY README.md docs/service.md docs/images/driver-frames.svg configs/default.toml \
  c/include/cdcr.h; do
  grep -qx "/usr/share/doc/cdcr/$name" <<<"$files" || fail "the package has no $name"
done

step "nothing was started or enabled"
! pgrep -u cdcr >/dev/null || fail "a process of the user cdcr runs"
[ ! -e /etc/systemd/system/multi-user.target.wants/cdcrd.service ] || fail "the unit is enabled"

step "the installed configuration and unit"
cdcrd check --config /etc/cdcr/cdcr.toml
if command -v systemd-analyze >/dev/null; then
  complaints=$(systemd-analyze verify --man=no /usr/lib/systemd/system/cdcrd.service 2>&1 | grep cdcr || true)
  [ -z "$complaints" ] || fail "systemd-analyze verify: $complaints"
fi

step "the daemon as the service runs it: its user, folder, limits, no capabilities"
unit() { sed -n "s/^$1=//p" /usr/lib/systemd/system/cdcrd.service; }
[ "$(unit User):$(unit RuntimeDirectory):$(unit Environment)" = cdcr:cdcr:CDCR_ROOT=/run/cdcr ] || fail "the unit changed"
[ ! -e /run/cdcr ] || fail "/run/cdcr exists already"
install -d -o cdcr -g cdcr -m 0700 /run/cdcr
# In memory under systemd, but not in every container.
[ "$(stat -f -c %T /run/cdcr)" = tmpfs ] || mount -t tmpfs -o uid=cdcr,gid=cdcr,mode=0700 tmpfs /run/cdcr
scratch=$(mktemp -d)
chmod 755 "$scratch"
configuration=/etc/cdcr/cdcr.toml
as_user() { setpriv --reuid=cdcr --regid=cdcr --init-groups --no-new-privs "$@"; }
bare=(--bounding-set=-all --inh-caps=-all)
instead=(--bounding-set=-all,+sys_nice,+ipc_lock --inh-caps=-all,+sys_nice,+ipc_lock --ambient-caps=+sys_nice,+ipc_lock)
clean=(env -i CDCR_ROOT=/run/cdcr PATH=/usr/bin:/bin)
raise_limits() { ulimit -r "$(unit LimitRTPRIO)" && ulimit -l unlimited; }
if (raise_limits && as_user "${bare[@]}" chrt -f 80 true) 2>/dev/null; then
  privileges=("${bare[@]}")
elif as_user "${instead[@]}" chrt -f 80 true 2>/dev/null; then
  skip "the unit's limits, which root may not raise here; two capabilities instead"
  privileges=("${instead[@]}")
else
  need realtime "real time, which this system does not grant; realtime.mode = \"prefer\" instead"
  privileges=("${bare[@]}")
  configuration=$scratch/prefer.toml
  sed 's/^mode = "require"/mode = "prefer"/' /etc/cdcr/cdcr.toml > "$configuration"
  chmod 644 "$configuration"
fi
as_service() { as_user "${bare[@]}" "${clean[@]}" "$@"; }
(
  raise_limits 2>/dev/null || true
  umask "$(unit UMask)"
  exec setpriv --reuid=cdcr --regid=cdcr --init-groups --no-new-privs "${privileges[@]}" "${clean[@]}" \
    /usr/bin/cdcrd run --config "$configuration"
) 2> "$scratch/log" &
daemon=$!
for try in $(seq 100); do
  if as_service cdcrctl status > "$scratch/status" 2>&1; then break; fi
  kill -0 "$daemon" 2>/dev/null || { cat "$scratch/log"; fail "the daemon ended"; }
  sleep 0.1
done
sleep 2
as_service cdcrctl status || { cat "$scratch/log"; fail "no status"; }
[ "$(stat -c %U /run/cdcr)" = cdcr ] || fail "/run/cdcr belongs to somebody else"
[ -n "$(find /run/cdcr -maxdepth 1 -name '*.data' -user cdcr)" ] || fail "no shared memory of the user cdcr"
# The folder is the barrier (docs/decisions/0013); its files are open to everyone with access to it.
[ "$(stat -c %a /run/cdcr)" = 700 ] || fail "/run/cdcr is open to others: $(stat -c %a /run/cdcr)"
file=$(find /run/cdcr -maxdepth 1 -name '*.data' -user cdcr -print -quit)
if setpriv --reuid=65534 --regid=65534 --clear-groups cat "$file" >/dev/null 2>&1; then fail "another user reads $file"; fi
others=$(find /dev/shm -user cdcr)
[ -z "$others" ] || fail "in /dev/shm: $others"
as_service cdcrctl stop
as_service cdcrctl reset
as_service MAINPID="$daemon" bash -c "$(unit ExecReload)" || fail "ExecReload"
for try in $(seq 100); do
  if grep -q 'SIGHUP: applied keys' "$scratch/log"; then break; fi
  [ "$try" != 100 ] || { cat "$scratch/log"; fail "ExecReload does not have the configuration read again"; }
  sleep 0.1
done
kill -TERM "$daemon"
wait "$daemon" || { cat "$scratch/log"; fail "the daemon ended with status $?"; }
daemon=
cat "$scratch/log"
left=$(find /run/cdcr /dev/shm -user cdcr -type f)
[ -z "$left" ] || fail "left in shared memory: $left"

# As systemd does when the service ends.
umount /run/cdcr 2>/dev/null || true

step "remove and purge"
echo "# changed by a test" >> /etc/cdcr/cdcr.toml
dpkg --remove cdcr
[ -e /etc/cdcr/cdcr.toml ] || fail "the configuration did not survive the removal"
[ ! -e /usr/bin/cdcrd ] || fail "cdcrd is still there"
dpkg --purge cdcr
! getent passwd cdcr >/dev/null || fail "the user cdcr is left"
! getent group cdcr >/dev/null || fail "the group cdcr is left"
left=$(find /etc /usr/bin /usr/lib/systemd /usr/lib/sysusers.d /usr/lib/udev /usr/share/doc /usr/share/man \
  /usr/share/bash-completion /usr/share/zsh /usr/share/fish /run /var/lib/dpkg/info \
  \( -name 'cdcr*' -o -name '_cdcr*' -o -name '60-cdcr*' \) 2>/dev/null || true)
[ -z "$left" ] || fail "left: $left"
echo "the package is good"

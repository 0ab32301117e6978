#!/usr/bin/env bash
# Installs the Debian package in a container with systemd, and tests docs/service.md. Takes two or three minutes, two of
# them for the container. Needs root, debootstrap, systemd-nspawn and a Debian mirror; otherwise reports a skip.
#   packaging/test-systemd.sh [PACKAGE.deb]
# CDCR_DEBIAN: a folder made by debootstrap with the packages below; it is not changed.
set -euo pipefail
cd "$(dirname "$0")/.."

step() { printf '\n--- %s\n' "$*"; }
skip() { echo "skipped: $*"; exit 0; }
[ "$(id -u)" = 0 ] || skip "a container needs root"
for program in debootstrap systemd-nspawn nsenter dpkg-deb; do
  command -v "$program" >/dev/null || skip "$program is not installed"
done
package=$(realpath "${1:-$(packaging/build.sh | tail -n 1)}")
scratch=$(mktemp -d /var/tmp/cdcr-systemd.XXXXXX)
nspawn=
clean_up() {
  if [ -n "$nspawn" ]; then
    kill "$nspawn" 2>/dev/null || true
    wait "$nspawn" 2>/dev/null || true
  fi
  rm -rf --one-file-system "$scratch"
}
trap clean_up EXIT
fail() { echo "FAILED: $*"; inside journalctl --no-pager --output=cat --lines=40 || true; exit 1; }

debian=${CDCR_DEBIAN:-$scratch/debian}
if [ ! -e "$debian/lib/systemd/systemd" ]; then
  step "a container"
  debootstrap --variant=minbase --include=systemd,systemd-sysv,dbus,udev bookworm "$debian" > "$scratch/debootstrap.log" 2>&1 \
    || { tail -n 3 "$scratch/debootstrap.log"; skip "debootstrap makes no container here"; }
fi
# The same package with a higher number, for the upgrade.
dpkg-deb --raw-extract "$package" "$scratch/newer"
sed -i 's/^Version: .*/&.1/' "$scratch/newer/DEBIAN/control"
dpkg-deb -Zgzip --build "$scratch/newer" "$scratch/newer.deb" >/dev/null
rm -r "$scratch/newer"

options=(--quiet --boot --register=no --console=pipe --volatile=overlay --capability=CAP_IPC_LOCK --machine="cdcr-test-$$")
[ -d /run/systemd/system ] || options+=(--keep-unit)
systemd-nspawn "${options[@]}" --directory="$debian" --bind-ro="$package:/package.deb" --bind-ro="$scratch/newer.deb:/newer.deb" \
  </dev/null > "$scratch/console" 2>&1 &
nspawn=$!
inside() { nsenter --target "$leader" --all env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
# Retries for 30 s, because machines stall.
until_true() { for _ in $(seq 150); do if "$@" >/dev/null 2>&1; then return 0; fi; sleep 0.2; done; return 1; }
boots() { leader=$(pgrep --parent "$nspawn") && inside systemctl is-system-running | grep -Eq 'running|degraded'; }
until_true boots || { cat "$scratch/console"; skip "systemd does not start in a container here"; }

as() { local user=$1; shift; inside setpriv --reuid "$user" --regid "$user" --init-groups "$@"; }
get() { inside systemctl show --value --property "$1" cdcrd; }
is() { [[ $(get "$1") == $2 ]]; } # a property and its pattern
logged() { grep -q "$1" <<<"$(inside journalctl --no-pager --output=cat --unit=cdcrd)"; }
starts() { inside systemctl reset-failed cdcrd && inside systemctl restart cdcrd && is StatusText 'holding (*' || fail "it does not start"; }
ends_with() { # status, and what makes it: it is not started again
  inside systemctl stop cdcrd
  ! inside systemctl start cdcrd 2>/dev/null || fail "it starts although it must end with $1"
  sleep 0.5
  is ExecMainStatus "$1" && is ActiveState failed && is NRestarts 0 || fail "not down with $1: $(get ExecMainStatus), $(get ActiveState)"
}
comes_back() { # after how it ended: another process, and the robot holds
  local before=$1 status=$2
  # In one query: during a restart, the old status text remains.
  another() {
    local now; now=$(inside systemctl show --property MainPID,ActiveState,StatusText cdcrd)
    [[ $now == *ActiveState=active* && $now == *'StatusText=holding (started)'* && $now != *"MainPID=$before"$'\n'* ]]
  }
  until_true another || fail "no new daemon after $status"
  logged "$status" || fail "the journal does not say $status"
}
drop_in() { inside sh -c "mkdir -p /etc/systemd/system/cdcrd.service.d && printf '$1' > /etc/systemd/system/cdcrd.service.d/$2.conf && systemctl daemon-reload"; }
inside sh -c 'groupadd robot; useradd -G robot member; useradd other'

step "install: nothing is enabled or started"
inside apt-get install -qq ./package.deb >/dev/null 2>&1 || fail "apt does not install it"
is ActiveState inactive && is UnitFileState disabled || fail "it is $(get ActiveState), $(get UnitFileState)"
inside systemd-analyze verify --man=no cdcrd.service || fail "systemd-analyze verify"

step "start: ready when the loop runs"
if ! inside systemctl start cdcrd 2>/dev/null; then
  is ExecMainStatus 77 || fail "it does not start: $(get ExecMainStatus)"
  echo "skipped: the unit's limits, which a manager without CAP_SYS_RESOURCE cannot raise; capabilities instead, as docs/service.md says"
  drop_in '[Service]\nAmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK\nCapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK\n' realtime
fi
inside sh -c 'printf "[transport]\ngroup = \"robot\"\n" >> /etc/cdcr/cdcr.toml'
starts
logged 'real time: SCHED_FIFO, pinned, memory locked' || fail "not real time"
inside journalctl --no-pager --unit=cdcrd CDCR_REASON=started | grep -q holding || fail "no field CDCR_REASON"

step "clients: the service's user and a member; not root, not others"
for user in cdcr member; do as "$user" cdcrctl --root /run/cdcr status >/dev/null || fail "$user is refused"; done
for user in root other; do ! as "$user" cdcrctl --root /run/cdcr status 2>/dev/null || fail "$user is let in"; done
# Read completely first, because grep -q ends at its first match.
output=$(as member cdcrctl status 2>&1 || true)
grep -q 'one runs as the service.*--root /run/cdcr' <<<"$output" || fail "the output does not name the service: $output"

step "reload, the signal of the stop, a restart while a client feeds"
inside sh -c 'printf "[controller]\nrefinement_steps = 2\n" >> /etc/cdcr/cdcr.toml'
inside systemctl reload cdcrd
until_true logged 'applied keys.*controller.refinement_steps' || fail "reload"
# Each time, systemd sets the mode of the folder back, and the daemon restores it.
for _ in 1 2 3 4 5; do
  inside systemctl reload cdcrd
  sleep 0.3
  as member cdcrctl --root /run/cdcr status >/dev/null || fail "a reload shuts out the group"
done
inside systemctl kill -s USR1 cdcrd
until_true is StatusText 'stopped (requested)*' || fail "SIGUSR1 does not stop"
inside systemctl kill -s KILL cdcrd
until_true is StatusText 'stopped (it was stopped or faulted before*' || fail "a daemon that is started again forgets the stop"
as member cdcrctl --root /run/cdcr reset || fail "reset"
as member cdcrctl --root /run/cdcr ref spiral --track > "$scratch/ref" 2>&1 &
until_true is StatusText 'tracking (*' || fail "it does not track: $(cat "$scratch/ref")"
inside systemctl restart cdcrd
is StatusText 'holding (started)*' || fail "it moves after a restart"
! wait $! || fail "the client does not notice the restart"
cat "$scratch/ref"

step "killed, hung, its folder emptied: started again"
p=$(get MainPID); inside systemctl kill -s KILL cdcrd; comes_back "$p" 'status=9/KILL'
p=$(get MainPID); inside systemctl kill -s STOP cdcrd; comes_back "$p" 'Watchdog timeout'
p=$(get MainPID); inside sh -c 'rm -r /run/cdcr/*'; comes_back "$p" 'status=83'

step "what a restart cannot repair: left"
drop_in '[Service]\nExecStart=\nExecStart=/usr/bin/cdcrd run --nonsense\n' try; ends_with 2
drop_in '[Service]\nExecStart=\nExecStart=/usr/bin/cdcrd run --set nonsense=1\n' try; ends_with 78
drop_in '[Service]\nEnvironment=CDCR_ROOT=/run\n' try; ends_with 73
drop_in '[Service]\nLimitRTPRIO=0\nAmbientCapabilities=\nCapabilityBoundingSet=\n' try; ends_with 77
inside rm /etc/systemd/system/cdcrd.service.d/try.conf; inside systemctl daemon-reload
starts

step "a journal that stands still"
inside systemctl kill -s STOP systemd-journald
for _ in $(seq 30); do as member cdcrctl --root /run/cdcr stop >/dev/null && as member cdcrctl --root /run/cdcr reset >/dev/null || fail "a request is not answered"; done
inside timeout 20 systemctl restart cdcrd || fail "the daemon does not end"
is StatusText 'holding (started)*' || fail "the daemon does not start"
inside systemctl kill -s CONT systemd-journald

step "upgrade, removal, purge"
p=$(get MainPID)
inside apt-get install -qq ./newer.deb >/dev/null 2>&1 || fail "no upgrade"
[ "$(get MainPID)" = "$p" ] && is ActiveState active || fail "the upgrade restarts the daemon"
inside systemctl -q enable cdcrd
inside apt-get remove -qq cdcr >/dev/null 2>&1 || fail "no removal"
logged 'stopped: the daemon ends' || fail "the robot was not brought to rest"
inside test -e /etc/cdcr/cdcr.toml || fail "the configuration is gone"
inside apt-get purge -qq cdcr >/dev/null 2>&1 || fail "no purge"
left=$(inside find /etc /usr /run /dev/shm /var/lib/dpkg/info /var/lib/systemd -name '*cdcr*')
[ -z "$left" ] || fail "left: $left"
! inside getent passwd cdcr || fail "the user cdcr is left"
echo "the service is good"

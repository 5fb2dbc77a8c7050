#!/usr/bin/env bash
# Builds the Debian package and tries it on a clean Debian: installs it, prints a case on the simulated printer, upgrades
# under the running server, removes and purges. As root; needs debootstrap, cargo-deb and a mirror that apt knows (or MIRROR=URL).
#
#     deploy/try-package.sh [--no-build]
#
# There is no service manager in the clean root: the server is started as its unit would, as the user lumenfab.
set -euo pipefail
cd "$(dirname "$0")/.."
[ "$(id -u)" = 0 ] || { echo 'error: a clean root can be made by root alone: run it with sudo' >&2; exit 2; }
for tool in debootstrap cargo-deb setpriv; do
    command -v "$tool" >/dev/null || { echo "error: $tool is not installed" >&2; exit 2; }
done
# Mounts of their own, gone with the script.
[ "${IN_MOUNTS:-}" = 1 ] || exec env IN_MOUNTS=1 unshare --mount "$0" "$@"

release=$(. /etc/os-release && printf '%s' "$VERSION_CODENAME")
mirror=${MIRROR:-$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' | grep -v security | sort -u | head -1)}
work=$(mktemp -d)
root=$work/root
server=
end() {
    [ -z "$server" ] || kill -KILL "$server" 2>/dev/null || true
    umount -l "$root/proc" "$root/dev/pts" 2>/dev/null || true
    rm -rf --one-file-system "$work"
}
trap end EXIT
step() { printf '\n== %s\n' "$1"; }
fail() { printf 'FAILED: %s\n' "$1" >&2; exit 1; }
inside=(chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive LC_ALL=C)
user=("${inside[@]}" setpriv --reuid=lumenfab --regid=lumenfab --init-groups env HOME=/var/lib/lumenfab
    STATE_DIRECTORY=/var/lib/lumenfab CONFIGURATION_DIRECTORY=/etc/lumenfab)
# All files but those of the package manager itself.
files() { (cd "$root" && find etc usr lib var -xdev \( -path var/lib/dpkg -o -path var/lib/apt -o -path var/cache -o -path var/log \
    -o -name '*-' \) -prune -o -print) | sort; }

step 'package'
[ "${1:-}" = --no-build ] || cargo build --release --locked --quiet
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)
for revision in 1 2; do
    cargo deb --no-build --quiet --deb-version "$version-$revision" --output "$work/lumenfab-$revision.deb"
done
dpkg-deb --info "$work/lumenfab-1.deb" | sed -n '/Package:/,$p'

step "clean root: $release"
debootstrap --variant=minbase --include=adduser "$release" "$root" "$mirror" >"$work/debootstrap.log" || { tail -20 "$work/debootstrap.log"; fail 'debootstrap'; }
mount -t proc proc "$root/proc"
mkdir -p "$root/dev/pts"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
rm -f "$root/dev/ptmx" && ln -s pts/ptmx "$root/dev/ptmx"
cp /etc/resolv.conf "$root/etc/" 2>/dev/null || true
printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d" && chmod +x "$root/usr/sbin/policy-rc.d"
cp "$work"/lumenfab-[12].deb "$root/root/"
# What the package needs from Debian is there before, so that the files of a purge can be compared.
needed=$(dpkg-deb --field "$work/lumenfab-1.deb" Depends | sed 's/([^)]*)//g; s/,/ /g')
# shellcheck disable=SC2086
"${inside[@]}" apt-get install -y -q --no-install-recommends $needed >"$work/apt.log" || { tail -20 "$work/apt.log"; fail 'apt-get'; }
files >"$work/before"

step 'install'
"${inside[@]}" dpkg -i /root/lumenfab-1.deb
"${inside[@]}" id lumenfab | grep -q dialout || fail 'the user lumenfab is not in dialout'
[ "$(stat -c '%a' "$root/var/lib/lumenfab")" = 700 ] || fail 'others can read the state directory'
[ "$("${inside[@]}" lumenfab --version)" = "lumenfab $version" ] || fail 'another version'
[ -e "$root/etc/systemd/system/multi-user.target.wants/lumenfab.service" ] || printf 'no service manager in this root: the unit is not enabled\n'

serve() {
    "${user[@]}" lumenfab serve 2>>"$work/serve.log" &
    server=$!
    for _ in $(seq 100); do [ -S "$root/var/lib/lumenfab/lumenfab.sock" ] && "${user[@]}" lumenfab queue list >/dev/null 2>&1 && return; sleep 0.1; done
    cat "$work/serve.log"
    fail 'the server does not answer'
}
states() { "${user[@]}" lumenfab queue list --json "$@" | grep -o '"state":"[^"]*"' | sort | uniq -c; }
until_state() {
    for _ in $(seq 1200); do
        if states | grep -q "\"$1\"" || states --over | grep -q "\"$1\""; then return; fi
        sleep 0.25
    done
    states; states --over; cat "$work/serve.log"
    fail "no job became $1"
}

step 'print'
serve
"${user[@]}" lumenfab run --out /var/lib/lumenfab/first >"$work/run.log" 2>&1 || { cat "$work/run.log"; fail 'lumenfab run'; }
"${user[@]}" lumenfab queue add /var/lib/lumenfab/first/job.gcode
until_state awaiting-bed-clear
"${user[@]}" lumenfab queue clear-bed
until_state finished
states --over

step 'upgrade under the running server'
"${user[@]}" lumenfab queue add /var/lib/lumenfab/first/job.gcode
"${inside[@]}" dpkg -i /root/lumenfab-2.deb
kill -0 "$server" || fail 'the upgrade ended the server'
until_state awaiting-bed-clear
"${user[@]}" lumenfab queue clear-bed
kill -TERM "$server"
wait "$server" || fail 'the server did not end well'
serve
"${user[@]}" lumenfab queue list --over
[ "$("${user[@]}" lumenfab queue list --over --json | grep -o '"state":"finished"' | wc -l)" = 2 ] || fail 'jobs are gone after the upgrade'
kill -TERM "$server"
wait "$server" || fail 'the server did not end well'
server=

step 'remove keeps the queue, purge leaves nothing'
"${inside[@]}" dpkg --remove lumenfab
[ -e "$root/var/lib/lumenfab" ] || fail 'removing took the state with it'
[ -e "$root/etc/lumenfab/config.toml" ] || fail 'removing took the configuration with it'
"${inside[@]}" dpkg --purge lumenfab
files >"$work/after"
diff "$work/before" "$work/after" || fail 'a purge leaves files'
! "${inside[@]}" getent passwd lumenfab || fail 'the user is still there'
printf '\ninstalled, printed, upgraded, removed and purged: nothing is left\n'

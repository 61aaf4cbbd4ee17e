# Of scripts/package: the package in a clean Debian root. Sourced.

# Packages that a .deb depends on, the first of each choice.
dependencies_of() {  # PACKAGE
  dpkg-deb -f "$1" Depends | tr ',' '\n' | sed 's/([^)]*)//g; s/|.*//; s/:any//; s/ //g'
}

test_package() {
  scripts/setup build libraries package kernel
  ((EUID == 0)) || cannot "a Debian root needs root (or sudo scripts/package --test)"
  local begin=$SECONDS version root="$work/root-test"
  version="$(version_now)"
  # Two versions of the same source.
  build_native "$version+1" "$work/out-next"
  build_native "$version" "$work/out"
  judge "$work"/out/*.changes
  local package next
  package="$(find "$work/out" -name 'omnihdr_*.deb')"
  next="$(find "$work/out-next" -name 'omnihdr_*.deb')"

  local include
  include="$(dependencies_of "$package" | sort -u | paste -sd, -)"
  if [[ ! -f "$root/ready" || "$(<"$root/ready")" != "$include" ]]; then
    rm -rf "$root"
    echo "scripts/package: making a clean Debian root, once"
    mmdebstrap --quiet --variant=apt --include="$include,systemd,systemd-sysv,udev,kmod,jq,bash-completion" \
      bookworm "$root" >"$work/root-test.log" 2>&1 || {
      tail -n 5 "$work/root-test.log" >&2
      cannot "mmdebstrap cannot make a Debian root here"
    }
    echo "$include" >"$root/ready"
  fi

  echo "scripts/package: a simulated drive in the clean root"
  unshare --mount --propagation private bash -c '
    set -e
    root="$1" package="$2" drive="$3" layer="$(mktemp -d)"
    mount -t tmpfs layer "$layer"
    mkdir "$layer"/{above,work,root}
    mount -t overlay -o "lowerdir=$root,upperdir=$layer/above,workdir=$layer/work" overlay "$layer/root"
    mount -t proc proc "$layer/root/proc"
    mount --bind /dev "$layer/root/dev"
    cp "$package" "$layer/root/omnihdr.deb"
    install -m 755 "$drive" "$layer/root/simulated-drive"
    in_root() { env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive chroot "$layer/root" "$@"; }
    in_root dpkg -i /omnihdr.deb
    in_root dpkg --verify omnihdr
    in_root bash /simulated-drive
    in_root dpkg --purge omnihdr' in "$root" "$package" systemd/debian/tests/simulated-drive \
    >"$work/drive.log" 2>&1 || {
    tail -n 20 "$work/drive.log" >&2
    echo "scripts/package: the installed package does not work in a clean root: $work/drive.log" >&2
    return 1
  }

  local tree status=0
  tree="$(mktemp -d)"
  chmod 755 "$tree"
  mkdir -p "$tree/test"
  [[ -n "${OMNIHDR_PREBUILT:-}" ]] || build release omnihdr
  build/release/bin/omnihdr simulate "$tree/test/drive" --scene yard --width 128 --samples 1 --positions 20 >/dev/null
  cp "$package" "$tree/test/omnihdr.deb"
  cp "$next" "$tree/test/next.deb"
  cp tests/systemd/package_test.sh "$tree/test/"
  echo 'sh /test/package_test.sh' >"$tree/test/command"
  tests/systemd/settle "$tree"
  tests/systemd/boot "$work/guest" "$tree" --root "$root" --longest 900 || status=$?
  rm -rf "$tree"
  ((status == 0)) || return "$status"
  echo "scripts/package: installed, upgraded over a running survey, removed and purged; $((SECONDS - begin)) s in all"
}

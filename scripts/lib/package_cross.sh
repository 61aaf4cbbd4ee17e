# Of scripts/package: the package for another architecture, built in a Debian root of its own, so that this machine's
# packages stay as they are. Sourced.

# cross_build ARCHITECTURE: into build/package/out-ARCHITECTURE.
cross_build() {
  local architecture="$1" root="$work/root-cross-$1" out="$work/out-$1"
  scripts/setup package
  ((EUID == 0)) || cannot "a Debian root with the packages of two architectures needs root (or sudo scripts/package --arch $architecture)"
  local wanted
  wanted="$({ control_file; cat scripts/lib/package_cross.sh; } | sha256sum)"
  if [[ ! -f "$root/ready" || "$(<"$root/ready")" != "$wanted" ]]; then
    echo "scripts/package: making a Debian root for $architecture, once"
    mkdir -p "$work"
    if [[ ! -f "$root/base" ]]; then
      rm -rf "$root"
      mmdebstrap --quiet --variant=apt --architectures="amd64,$architecture" --include=build-essential \
        bookworm "$root" >"$work/root-cross.log" 2>&1 || {
        tail -n 5 "$work/root-cross.log" >&2
        cannot "mmdebstrap cannot make a Debian root here"
      }
      touch "$root/base"
    fi
    mkdir -p "$root/build/source/debian"
    control_file >"$root/build/source/debian/control"
    cross_in "$root" bash -c "apt-get -q update &&
      apt-get -q -y --no-install-recommends install crossbuild-essential-$architecture &&
      apt-get -q -y --no-install-recommends build-dep \
      --host-architecture $architecture --build-profiles cross,nocheck /build/source" \
      >"$work/root-cross.log" 2>&1 || {
      tail -n 15 "$work/root-cross.log" >&2
      echo "scripts/package: what the cross build needs cannot be installed" >&2
      return 1
    }
    echo "$wanted" >"$root/ready"
  fi
  assemble "$root/build/source" "$(version_now)"
  rm -rf "$out"
  mkdir -p "$out"
  cross_in "$root" bash -c "cd /build/source && DEB_BUILD_OPTIONS='parallel=$(job_count) nocheck' \
    dpkg-buildpackage --build=binary --no-sign --host-arch=$architecture --build-profiles=cross,nocheck" \
    >"$work/cross.log" 2>&1 || {
    tail -n 15 "$work/cross.log" >&2
    echo "scripts/package: the cross build fails: $work/cross.log" >&2
    return 1
  }
  mv "$root"/build/omnihdr*.{deb,changes,buildinfo} "$out/"
  judge "$out"/*.changes
  check_symbols "$out"
  try_emulated "$root" "$architecture" "$out"
  ls -l "$out"/*.deb
}

# try_emulated ROOT ARCHITECTURE OUT: the packaged tool on a simulated drive, under an emulator, in the root that has
# the libraries of both architectures. Its views must be nearer to the scene than the single frames are.
try_emulated() {
  local root="$1" architecture="$2" out="$3" emulator begin=$SECONDS
  emulator="qemu-$(dpkg-architecture --host-arch "$architecture" --query DEB_HOST_GNU_CPU 2>/dev/null)-static"
  rm -rf "$root/build/trial"
  mkdir "$root/build/trial"
  dpkg-deb -x "$out"/omnihdr_*"_$architecture.deb" "$root/build/trial/package"
  file "$root/build/trial/package/usr/bin/omnihdr" | sed "s|.*/usr|/usr|; s/, BuildID.*//"
  cross_in "$root" bash -e -c '
    cd /build/trial
    omnihdr() { "$0" package/usr/bin/omnihdr "$@"; }
    omnihdr --version
    "$0" package/usr/bin/omnihdrd --config package/etc/omnihdr/omnihdr.toml --check
    omnihdr simulate drive --scene yard --width 384 --samples 1 --positions 4
    omnihdr process drive
    omnihdr verify drive
    omnihdr evaluate drive | tee evaluation
    awk "/^ *mean / { found = 1; exit !(\$2 < \$3) } END { if (!found) exit 1 }" evaluation' "$emulator" \
    >"$work/trial.log" 2>&1 || {
    tail -n 15 "$work/trial.log" >&2
    echo "scripts/package: the programs do not do under an emulator: $work/trial.log" >&2
    return 1
  }
  grep -E '^ *mean ' "$root/build/trial/evaluation" |
    awk '{ print "scripts/package: a simulated drive under an emulator: error of the views " $2 ", of single frames " $3 }'
  echo "scripts/package: $((SECONDS - begin)) s for it"
}

# cross_in ROOT COMMAND...: with the kernel's file systems that compilers and package scripts ask for.
cross_in() {
  local root="$1"
  shift
  # What is mounted is gone with the namespace.
  unshare --mount --propagation private bash -c '
    root="$1"; shift
    mount -t proc proc "$root/proc"
    mount --rbind /dev "$root/dev"
    exec env SOURCE_DATE_EPOCH="$SOURCE_DATE_EPOCH" LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive HOME=/build \
      chroot "$root" "$@"' in "$root" "$@"
}

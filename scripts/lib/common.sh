# Shared by scripts/test and scripts/demo; sourced, in bash, with errors fatal.

top="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
cd "$top"

# Objects are kept by content and not by where the checkout lies, so that another clone finds them.
export CCACHE_BASEDIR="${CCACHE_BASEDIR:-$top}" CCACHE_NOHASHDIR=1

# How many compilers at once: one a core, and no more than the free memory holds (1.2 GB each).
job_count() {
  local cores free_kb by_memory
  cores="$(nproc)"
  free_kb="$(awk '/^MemAvailable:/ { print $2 }' /proc/meminfo)"
  by_memory=$((free_kb / 1200000))
  ((by_memory >= 1)) || by_memory=1
  echo $((cores < by_memory ? cores : by_memory))
}

# build PRESET [TARGET...]: configures (when needed) and builds build/PRESET, all of it or the targets.
build() {
  local preset="$1"
  shift
  cmake --preset "$preset" >"build/$preset.configure.log" 2>&1 || {
    cat "build/$preset.configure.log" >&2
    return 1
  }
  local targets=()
  (($# == 0)) || targets=(--target "$@")
  cmake --build --preset "$preset" --parallel "$(job_count)" "${targets[@]}"
}

mkdir -p build

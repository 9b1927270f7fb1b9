#!/usr/bin/env bash
# Write constraints.txt: one version of every package, for every Python and platform that pyproject.toml allows.
# Only names, versions and markers: no host, no hash, no local build. Needs uv (pip install uv).
set -euo pipefail
cd "$(dirname "$0")/.."
uv=${UV:-uv}
command -v "$uv" >/dev/null || { echo "error: uv is not on the path; say UV=/path/to/uv $0" >&2; exit 2; }
env -u UV_FIND_LINKS -u PIP_FIND_LINKS "$uv" --no-config lock --quiet "$@"
"$uv" --no-config export --quiet --frozen --all-extras --no-hashes --no-emit-project --no-annotate --no-header --output-file constraints.txt
if grep -nE '://|^-|==[^ ]*\+' constraints.txt; then
    echo "error: constraints.txt names a host, an option or a local build in the lines above" >&2
    exit 1
fi
echo "constraints.txt: $(wc -l < constraints.txt) packages"

#!/usr/bin/env bash
# Gets Mesa's Vulkan driver for processors (lavapipe) from Debian 12's backports, and puts it into a folder of its own: the
# one named, XPL_MESA, or ~/.cache/xpl/mesa. Nothing of the system is changed.
set -euo pipefail

folder=${1:-${XPL_MESA:-$HOME/.cache/xpl/mesa}}
mkdir -p "$folder"
folder=$(cd -- "$folder" && pwd)
work=$(mktemp -d)
trap 'rm -rf -- "$work"' EXIT
cd -- "$work"

archive=$(grep -rhoE 'https?://[^ ]+/debian/?( |$)' /etc/apt/sources.list /etc/apt/sources.list.d 2> /dev/null | head -n 1 | tr -d ' ' || true)
mkdir -p lists/partial cache/archives/partial parts
printf 'Types: deb\nURIs: %s\nSuites: bookworm-backports\nComponents: main\nSigned-By: %s\n' \
    "${archive:?/etc/apt names no Debian archive}" /usr/share/keyrings/debian-archive-keyring.gpg > parts/backports.sources
apt() {
    apt-get -qq -o Dir::Etc::sourcelist=/dev/null -o "Dir::Etc::sourceparts=$work/parts" -o "Dir::State::lists=$work/lists" \
        -o "Dir::Cache=$work/cache" -o APT::Sandbox::User=root "$@"
}
apt update
apt download mesa-vulkan-drivers
dpkg-deb -x ./*.deb unpacked

install -m 644 "$(find unpacked -name libvulkan_lvp.so)" "$folder/libvulkan_lvp.so"
if absent=$(ldd "$folder/libvulkan_lvp.so" | grep 'not found'); then
    printf 'libvulkan_lvp.so lacks libraries; apt-get install libgl1-mesa-dri libwayland-client0 brings them:\n%s\n' "$absent" >&2
    exit 1
fi
printf '{"file_format_version": "1.0.0", "ICD": {"api_version": "1.3.0", "library_path": "%s"}}\n' \
    "$folder/libvulkan_lvp.so" > "$folder/lvp_icd.json"
printf '%s\n' "$folder/lvp_icd.json"

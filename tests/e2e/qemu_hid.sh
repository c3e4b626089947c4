#!/usr/bin/env bash
# qemu_hid.sh INCISED UHID_STYLUS FOLDER: runs both in a virtual machine with a kernel of Debian's, where a uhid device is
# a real /dev/hidraw0. 77 (skipped), with a line that says why, where something for that is missing; ten seconds to a minute
# of emulation (a processor that can run virtual machines is not asked for).
#
# The kernel is that of the package linux-image-cloud-amd64: installed, or unpacked by `dpkg-deb -x` in a folder that
# INCISE_KERNEL names.
set -euo pipefail

incised="$1" stylus="$2" folder="$3"

skip() {
  echo "skipped: $*"
  exit 77
}

for tool in qemu-system-x86_64 busybox cpio; do
  command -v "$tool" > /dev/null || skip "$tool is not installed (packages qemu-system-x86, busybox-static, cpio)"
done
system="${INCISE_KERNEL:-}"
kernel="" modules=""
for candidate in "$system"/boot/vmlinuz-*; do
  [[ -r "$candidate" ]] || continue
  version="${candidate##*/vmlinuz-}"
  found="$(find "$system/lib/modules/$version" -name uhid.ko 2> /dev/null | head -n 1)"
  [[ -n "$found" ]] && kernel="$candidate" modules="${found%/uhid.ko}"
done
[[ -n "$kernel" ]] ||
  skip "no kernel with uhid in ${system:-/}boot: unpack linux-image-*-cloud-amd64 and name its folder in INCISE_KERNEL"

rm -rf "$folder"
mkdir -p "$folder"/root/{bin,dev,proc,sys,tmp,modules,lib64}
root="$folder/root"
cp "$(command -v busybox)" "$root/bin/busybox"
tetgen="$(dirname "$incised")/incise-tetgen"  # fills the phantom
cp "$incised" "$root/bin/incised"
cp "$tetgen" "$root/bin/incise-tetgen"
cp "$stylus" "$root/bin/uhid_stylus"
# The libraries that they name, where their loader looks for them.
ldd "$incised" "$stylus" "$tetgen" | grep -o '/[^ ]*' | grep '\.so' | sort -u | while read -r library; do
  mkdir -p "$root$(dirname "$library")"
  cp -L "$library" "$root$library"
done
mkdir -p "$root/share/incise"
cp -r "$(dirname "$0")/../../config/devices" "$root/share/incise/devices"
for module in hid uhid hid-generic; do cp "$modules/$module.ko" "$root/modules/"; done
cat > "$root/init" << 'END'
#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sysfs /sys
/bin/busybox mount -t devtmpfs devtmpfs /dev
for module in hid uhid hid-generic; do /bin/busybox insmod /modules/$module.ko; done
/bin/busybox ip link set lo up
/bin/uhid_stylus
/bin/busybox poweroff -f
END
chmod +x "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet) | gzip -1 > "$folder/initramfs"
timeout 500 qemu-system-x86_64 -machine q35,accel=tcg -cpu max -smp 2 -m 768 -nodefaults -no-user-config -display none \
  -serial stdio -no-reboot -kernel "$kernel" -initrd "$folder/initramfs" \
  -append "console=ttyS0 quiet panic=-1" < /dev/null | tr -d '\r' > "$folder/console" || true
grep -a -v '^\[' "$folder/console" | tail -n 20
rm -rf "$root" "$folder/initramfs"
grep -a -q '^verdict: good' "$folder/console"

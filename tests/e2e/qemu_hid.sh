#!/usr/bin/env bash
# qemu_hid.sh uhid|usb INCISED KERNEL_STYLUS FOLDER: runs both in a virtual machine with a kernel of Debian's, where a device
# of uhid's or a USB gadget is a real /dev/hidraw0. 77 (skipped), with a line that says why, where something for that is
# missing; ten seconds to two minutes of emulation (a processor that can run virtual machines is not asked for).
#
# uhid takes the kernel of the package linux-image-cloud-amd64 or linux-image-amd64: installed, or unpacked by `dpkg-deb -x`
# in a folder that INCISE_KERNEL names. usb takes that of linux-image-amd64 in such a folder.
set -euo pipefail

bus="$1" incised="$2" stylus="$3" folder="$4"

skip() {
  echo "skipped: $*"
  exit 77
}

for tool in qemu-system-x86_64 busybox cpio; do
  command -v "$tool" > /dev/null || skip "$tool is not installed (packages qemu-system-x86, busybox-static, cpio)"
done
system="${INCISE_KERNEL:-}"
case "$bus" in  # a module after those that it needs
  uhid) package=linux-image-cloud-amd64 asked=uhid modules=(hid uhid hid-generic) ;;
  usb)
    [[ -n "$system" ]] || skip "INCISE_KERNEL is not set; ./dev test --usb fetches a kernel and runs this test"
    package=linux-image-amd64 asked=dummy_hcd
    modules=(usb-common usbcore udc-core configfs libcomposite usb_f_hid dummy_hcd hid hid-generic usbhid)
    ;;
esac
kernel="" tree=""
for candidate in "$system"/boot/vmlinuz-*; do
  [[ -r "$candidate" ]] || continue
  lib="$system/lib/modules/${candidate##*/vmlinuz-}"
  [[ -z "$(find "$lib" -name "$asked.ko" 2> /dev/null)" ]] || kernel="$candidate" tree="$lib"
done
[[ -n "$kernel" ]] ||
  skip "no kernel with $asked in ${system:-/}boot: unpack $package's and name its folder in INCISE_KERNEL"

rm -rf "$folder"
mkdir -p "$folder"/root/{bin,dev,proc,sys,tmp,modules,lib64}
root="$folder/root"
cp "$(command -v busybox)" "$root/bin/busybox"
tetgen="$(dirname "$incised")/incise-tetgen"  # fills the phantom
cp "$incised" "$root/bin/incised"
cp "$tetgen" "$root/bin/incise-tetgen"
cp "$stylus" "$root/bin/kernel_stylus"
# The libraries that they name, where their loader looks for them.
ldd "$incised" "$stylus" "$tetgen" | grep -o '/[^ ]*' | grep '\.so' | sort -u | while read -r library; do
  mkdir -p "$root$(dirname "$library")"
  cp -L "$library" "$root$library"
done
mkdir -p "$root/share/incise"
cp -r "$(dirname "$0")/../../config/devices" "$root/share/incise/devices"
for module in "${modules[@]}"; do find "$tree" -name "$module.ko" -exec cp {} "$root/modules/" \;; done
cat > "$root/init" << END
#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sysfs /sys
/bin/busybox mount -t devtmpfs devtmpfs /dev
for module in ${modules[*]}; do /bin/busybox insmod /modules/\$module.ko; done
[ $bus = uhid ] || /bin/busybox mount -t configfs configfs /sys/kernel/config
/bin/busybox ip link set lo up
/bin/kernel_stylus $bus
/bin/busybox poweroff -f
END
chmod +x "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet) | gzip -1 > "$folder/initramfs"
timeout 900 qemu-system-x86_64 -machine q35,accel=tcg -cpu max -smp 2 -m 768 -nodefaults -no-user-config -display none \
  -serial stdio -no-reboot -kernel "$kernel" -initrd "$folder/initramfs" \
  -append "console=ttyS0 quiet panic=-1" < /dev/null | tr -d '\r' > "$folder/console" || true
grep -a -v '^\[' "$folder/console" | tail -n 20
rm -rf "$root" "$folder/initramfs"
grep -a -q '^verdict: good' "$folder/console"

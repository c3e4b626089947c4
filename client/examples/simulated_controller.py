"""Writes a six-axis controller that is not there, for umockdev-run (config/devices/DEVICES.md): simulated_controller.py [FOLDER]."""
import pathlib
import struct
import sys

# Report 1: x, y, z, rx, ry, rz as 16 bits, -350 to 350; two buttons; six bits of padding.
DESCRIPTOR = bytes.fromhex("05010908a101 8501 16a2fe265e01 75109506 093009310932093309340935 8102"
                           "0509 19012902 15002501 75019502 8102 75069501 8103 c0")
USB = "/devices/pci0000:00/0000:00:14.0/usb1/1-1"
HID = USB + "/1-1:1.0/0003:1234:ABCD.0001"
# What udev would show: the node, its HID device, the USB interface and device that these belong to.
DEVICES = f"""P: {HID}/hidraw/hidraw0
N: hidraw0
E: SUBSYSTEM=hidraw
E: DEVNAME=/dev/hidraw0

P: {HID}
E: SUBSYSTEM=hid
E: HID_ID=0003:00001234:0000ABCD
E: HID_NAME=Simulated
E: HID_UNIQ=S1
H: report_descriptor={DESCRIPTOR.hex().upper()}

P: {USB}/1-1:1.0
E: SUBSYSTEM=usb
E: DEVTYPE=usb_interface
A: bInterfaceNumber=00\\n

P: {USB}
E: SUBSYSTEM=usb
E: DEVTYPE=usb_device
A: idVendor=1234\\n
A: idProduct=abcd\\n
A: manufacturer=Nobody\\n
A: product=Simulated\\n
A: serial=S1\\n

"""


def as_script(report):
    """A report in umockdev's scripts: ^@, ^A, ... are the bytes below a space, ^` is ^."""
    return b"".join(bytes([94, byte + 64]) if byte < 32 else b"^`" if byte == 94 else bytes([byte]) for byte in report)


folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".")
size = len(DESCRIPTOR)
answers = {"HIDIOCGRDESCSIZE": struct.pack("<i", size), "HIDIOCGRDESC": struct.pack("<I4096s", size, DESCRIPTOR),
           "HIDIOCGRAWINFO": struct.pack("<IHH", 3, 0x1234, 0xABCD)}
(folder / "controller.umockdev").write_text(DEVICES)
(folder / "controller.ioctl").write_text(
    "@DEV /dev/hidraw0\n" + "".join(f"{name} 0 {data.hex().upper()}\n" for name, data in answers.items()))
with open(folder / "controller.script", "wb") as script:
    for i in range(700):  # at rest for a second, then pushed along y with the left button held, then at rest
        pushed = 125 <= i < 500
        report = struct.pack("<B6hB", 1, 0, 350 if pushed else 0, 0, 0, 0, 0, int(pushed))
        script.write(b"r 8 " + as_script(report) + b"\n")  # 8 ms after the one before

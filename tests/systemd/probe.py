"""What a process in the service's sandbox may do, one "name: verdict" a line; a copy of the unit runs it as root, so
that what is refused is refused by the sandbox and not by the owner of a file."""

import ctypes
import errno
import mmap
import os
import socket


def verdict(name, attempt):
    try:
        attempt()
        print(f"{name}: allowed")
    except OSError as error:
        print(f"{name}: {errno.errorcode.get(error.errno, error.errno)}")


def node(path, flags=os.O_RDWR):
    os.close(os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY))


def call(name, *arguments):
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        raise OSError(ctypes.get_errno(), name)


def write(path):
    with open(path, "w", encoding="utf-8") as file:
        file.write("x")


for device in ("/dev/null", "/dev/gpiochip0", "/dev/bus/usb/001/001", "/dev/ttyS0", "/dev/mem", "/dev/hpet", "/dev/tty0",
               "/dev/port"):
    verdict(device, lambda path=device: node(path))
verdict("write /etc", lambda: write("/etc/omnihdr/x"))
verdict("write /usr", lambda: write("/usr/x"))
verdict("write /var/lib", lambda: write("/var/lib/x"))
verdict("write /srv/omnihdr", lambda: write("/srv/omnihdr/x"))
verdict("write /proc/sys", lambda: write("/proc/sys/kernel/core_pattern"))
verdict("look into /home", lambda: os.listdir("/home"))
verdict("executable memory", lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_WRITE | mmap.PROT_EXEC))
verdict("packet socket", lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW))
verdict("netlink socket", lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 15))
verdict("namespace", lambda: call("unshare", 0x10000000))
verdict("mount", lambda: call("mount", b"none", b"/tmp", b"tmpfs", 0, None))
verdict("real time 20", lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20)))
verdict("real time 21", lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(21)))
verdict("lowest priority", lambda: os.setpriority(os.PRIO_PROCESS, 0, 19))

"""Runs a command on Debian's own kernel, which has SocketCAN, in an emulated machine (no KVM).

The host's file system is the guest's, read-only; what the guest writes is gone afterwards. ``vcan0`` is up with
CAN FD. Debian packages: qemu-system-x86, busybox-static, kmod, iproute2; the kernel is downloaded once by apt.
"""

import gzip
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TOOLS = {"qemu-system-x86_64": "qemu-system-x86", "depmod": "kmod", "modprobe": "kmod", "apt-get": "apt"}
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "can-raw", "vcan")
BUSYBOX = Path("/bin/busybox")
SHARE = "trans=virtio,version=9p2000.L,msize=512000"

INIT = f"""#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t devtmpfs dev /dev
mount -t proc proc /proc
for module in $(cat /modules/order); do insmod /modules/$module; done
mount -t 9p -o {SHARE},ro,cache=loose host /host
mount -t tmpfs none /own
mkdir /own/upper /own/work
mount -t overlay -o lowerdir=/host,upperdir=/own/upper,workdir=/own/work,xino=off none /new
mount -t proc proc /new/proc
mount -t sysfs sys /new/sys
mount -t devtmpfs dev /new/dev
mkdir -p /new/dev/shm /new/dev/pts
ln -s /proc/self/fd /new/dev/fd
mount -t tmpfs none /new/dev/shm
mount -t devpts none /new/dev/pts
mount -t tmpfs none /new/run
mkdir -p /new/run/result
mount -t 9p -o {SHARE} result /new/run/result
chroot /new /bin/sh -c "ip link add vcan0 txqueuelen 4096 mtu 72 type vcan"
chroot /new /bin/sh -c "ip link set vcan0 up; ip link set lo up"
chroot /new /bin/sh /run/result/command
echo $? > /new/run/result/status
sync
poweroff -f
"""


def missing() -> str:
    """What this machine lacks, by Debian package; empty if it can run a guest."""
    lacking = sorted({package for tool, package in TOOLS.items() if _tool(tool) is None})
    if not BUSYBOX.exists():
        lacking.append("busybox-static")
    if _tool("ip") is None:
        lacking.append("iproute2")
    return " ".join(lacking)


def _tool(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin:/sbin")


def _entry(number: int, name: str, mode: int, content: bytes) -> bytes:
    """One file of a cpio archive in the "newc" format that the kernel unpacks."""
    fields = (number, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + name.encode() + b"\0"
    return head + bytes(-len(head) % 4) + content + bytes(-len(content) % 4)


def _kernel(cache: Path) -> tuple[Path, Path]:
    """Kernel and initial file system, made at the first call."""
    initrd = cache / "initrd"
    if not initrd.exists():
        cache.mkdir(parents=True, exist_ok=True)
        depends = subprocess.run(
            ["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True, check=True
        ).stdout
        package = next(line.split()[-1] for line in depends.splitlines() if "Depends:" in line)
        subprocess.run(["apt-get", "download", "-qq", package], cwd=cache, check=True)
        (archive,) = cache.glob(f"{package}_*.deb")
        unpacked = cache / "kernel"
        shutil.rmtree(unpacked, ignore_errors=True)
        subprocess.run(["dpkg", "-x", archive, unpacked], check=True)
        archive.unlink()
        (modules,) = (unpacked / "lib" / "modules").iterdir()
        subprocess.run([str(_tool("depmod")), "-b", unpacked, modules.name], check=True)
        order: list[str] = []
        for module in MODULES:
            shown = subprocess.run(
                [str(_tool("modprobe")), "-d", unpacked, "-S", modules.name, "--show-depends", module],
                capture_output=True,
                text=True,
                check=True,
            ).stdout
            order += [line.split()[1] for line in shown.splitlines() if line.startswith("insmod")]
        order = list(dict.fromkeys(order))
        entries = [(name, 0o040755, b"") for name in ("bin", "modules", "host", "own", "new", "dev", "proc")]
        entries += [(f"modules/{Path(path).name}", 0o100644, Path(path).read_bytes()) for path in order]
        entries.append(("modules/order", 0o100644, "\n".join(Path(path).name for path in order).encode()))
        entries += [("bin/busybox", 0o100755, BUSYBOX.read_bytes()), ("init", 0o100755, INIT.encode())]
        packed = b"".join(_entry(i, *entry) for i, entry in enumerate([*entries, ("TRAILER!!!", 0, b"")], start=1))
        unfinished = cache / f"initrd.{os.getpid()}"
        unfinished.write_bytes(gzip.compress(packed, 1))
        unfinished.rename(initrd)
    (kernel,) = (cache / "kernel" / "boot").glob("vmlinuz-*")
    return kernel, initrd


def run(command: list[str], cache: Path, seconds: float = 280.0, **environment: str) -> tuple[int | None, str]:
    """Run a command as root in the guest.

    Returns
    -------
    int or None
        Its exit status; None if the guest never got that far.
    str
        Its output, after the kernel's.
    """
    kernel, initrd = _kernel(cache)
    with tempfile.TemporaryDirectory(prefix="canvm") as shared:
        given = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "HOME": "/root", **environment}
        lines = [f"export {name}={shlex.quote(value)}" for name, value in given.items()]
        lines += [f"cd {shlex.quote(os.getcwd())}", shlex.join(command)]
        Path(shared, "command").write_text("\n".join(lines) + "\n")
        machine = [
            *(
                "qemu-system-x86_64",
                "-M",
                "q35",
                "-accel",
                "tcg,thread=multi",
                "-cpu",
                "Westmere",  # numpy's sorting for wider vectors crashes in the emulator
                "-smp",
                "2",
                "-m",
                "1G",
            ),
            *("-nodefaults", "-no-user-config", "-display", "none", "-serial", "stdio", "-no-reboot"),
            *("-kernel", str(kernel), "-initrd", str(initrd)),
            *("-append", "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off tsc=reliable"),
            *("-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap"),
            *("-device", "virtio-9p-pci,fsdev=host,mount_tag=host"),
            *("-fsdev", f"local,id=result,path={shared},security_model=none"),
            *("-device", "virtio-9p-pci,fsdev=result,mount_tag=result"),
        ]
        try:
            done = subprocess.run(
                machine, stdin=subprocess.DEVNULL, capture_output=True, timeout=seconds, check=False
            )
            output = done.stdout + done.stderr
        except subprocess.TimeoutExpired as late:
            output = (late.stdout or b"") + f"\nended after {seconds:g} s".encode()
        status = Path(shared, "status")
        code = int(status.read_text()) if status.exists() else None
        return code, output.decode(errors="replace")


if __name__ == "__main__":
    found, text = run(sys.argv[1:], Path(os.environ.get("CREAK_CANVM", tempfile.gettempdir())) / "creak-canvm")
    sys.stdout.write(text)
    sys.exit(125 if found is None else found)

"""A link between two network namespaces: two TUN devices and this process, which carries packets from one to the other later, or never.

    relay.py NAMESPACE_A NAMESPACE_B

The kernel here need not have netem. A line of JSON on standard input changes what the link does ({"delay_ms": 20, "jitter_ms": 0, "loss": 0.01,
"is_cut": false}, each way, any of them) and is answered by a line with what has come to it so far, by the side that sent it: bytes and packets of IP.
It ends with its standard input. Needs root.
"""

import collections
import ctypes
import fcntl
import json
import os
import random
import select
import struct
import sys
import time

# The device's name on either side.
DEVICE = "far"
# linux/if_tun.h
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
# linux/sched.h
CLONE_NEWNET = 0x40000000
# Packets that are read before anything is written: neither side waits for long.
AT_ONCE = 64
# Packets that may be on their way; as in any router, what comes on top is dropped.
ON_THE_WAY = 20000


def open_device(namespace):
    """A TUN device in a namespace; gone when this process ends."""
    with open(f"/run/netns/{namespace}", "rb") as place:
        if ctypes.CDLL(None, use_errno=True).setns(place.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"entering {namespace}")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI))
    return device


class Way:
    """One direction."""

    def __init__(self, source, target, seed):
        self.source, self.target, self.random = source, target, random.Random(seed)
        self.waiting = collections.deque()
        self.bytes = self.packets = 0

    def take(self, link):
        """Reads what has come, and gives each packet the time at which it is due."""
        for _ in range(AT_ONCE):
            try:
                packet = os.read(self.source, 65536)
            except BlockingIOError:
                return
            self.bytes, self.packets = self.bytes + len(packet), self.packets + 1
            is_lost = link["is_cut"] or self.random.random() < link["loss"] or len(self.waiting) >= ON_THE_WAY
            if is_lost:
                continue
            due = time.monotonic() + (link["delay_ms"] + self.random.random() * link["jitter_ms"]) / 1e3
            # Packets of one way keep their order, as on most networks.
            self.waiting.append((max(due, self.waiting[-1][0]) if self.waiting else due, packet))

    def give(self):
        """Writes what is due; when the next is."""
        while self.waiting and self.waiting[0][0] <= time.monotonic():
            try:
                os.write(self.target, self.waiting.popleft()[1])
            except OSError:
                # The other side's device is down, or full: the packet is lost.
                pass
        return self.waiting[0][0] if self.waiting else None


def main():
    names = sys.argv[1:3]
    a, b = map(open_device, names)
    ways = [Way(a, b, 1), Way(b, a, 2)]
    link = {"delay_ms": 0.0, "jitter_ms": 0.0, "loss": 0.0, "is_cut": False}
    print(json.dumps({"device": DEVICE}), flush=True)
    while True:
        dues = [due for due in (way.give() for way in ways) if due is not None]
        wait = max(0.0, min(dues) - time.monotonic()) if dues else None
        ready, _, _ = select.select([a, b, sys.stdin], [], [], wait)
        for way in ways:
            if way.source in ready:
                way.take(link)
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            change = json.loads(line)
            if unknown := set(change) - set(link):
                raise SystemExit(f"unknown: {', '.join(unknown)}")
            link.update(change)
            so_far = {name: {"bytes": way.bytes, "packets": way.packets} for name, way in zip(names, ways)}
            print(json.dumps(so_far), flush=True)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Looks into the shards that `repose generate` writes: what is in them, and one view as pictures.

    read_views.py DATA/shard_00000.safetensors
    read_views.py DATA/shard_00000.safetensors --view 3 --out view3 [--without 2] [--alone 2]

The first prints a line per view. The second writes view3_depth.png (16 bits, 0.1 mm), view3_labels.png (instance ids) and, where the data has
color, view3_color.png, with all objects, without the object with that id, or with that object and nothing else.
Needs numpy and safetensors. The format is described in services/shared/dataset/README.md.
"""
import argparse, json, struct, zlib
import numpy as np
from safetensors import safe_open

RELATIONS = "left_of right_of in_front_of behind above below near touching centered aligned".split()


# Reading a shard, in ten lines: its views, and any layer as inverse depth (1/m, 0 = nothing) or color.
def open_shard(path):
    shard = safe_open(path, "np")
    assert shard.metadata()["format"] == "repose-views-2", shard.metadata()
    return shard, json.loads(zlib.decompress(shard.get_tensor("views").tobytes()))

def layer(shard, name, rect, channels=0):
    planes = np.frombuffer(zlib.decompress(shard.get_tensor(name).tobytes()), np.uint8).reshape(channels or 2, -1)
    folded = planes[0] | planes[1].astype(np.uint16) << 8
    values = np.cumsum(planes, 1, np.uint8).T if channels else np.cumsum((folded >> 1) ^ -(folded & 1), dtype=np.uint16) * 1e-4
    return values.reshape(rect["height"], rect["width"], *values.shape[1:])


def compose(shard, views, v, present):
    """The picture of view `v` with the objects for whose id `present` holds: depth in metres (0 = nothing), labels, color or None."""
    view = views[v]
    height, width = view["camera"]["height"], view["camera"]["width"]
    inverse, labels = np.zeros((height, width)), np.zeros((height, width), np.uint16)
    color = np.full((height, width, 3), (205, 212, 220), np.uint8) if view["color"] else None
    layers = [(f"{v:04}/background", view["background"], 0)] if present(0) else []
    layers += [(f"{v:04}/object_{k}/alone", o["alone"], o["id"]) for k, o in enumerate(view["objects"]) if present(o["id"])]
    for name, rect, label in layers:
        window = np.s_[rect["y0"]:rect["y0"] + rect["height"], rect["x0"]:rect["x0"] + rect["width"]]
        near = layer(shard, name, rect)
        wins = near > inverse[window]
        inverse[window][wins], labels[window][wins] = near[wins], label
        if color is not None:
            color[window][wins] = layer(shard, name + "/color", rect, 3)[wins]
    return np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0), labels, color


def write_png(path, pixels):
    """8- or 16-bit grey, or 8-bit RGB."""
    kind, bits = (2, 8) if pixels.ndim == 3 else (0, 8 * pixels.itemsize)
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    chunk = lambda name, data: struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    head = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], bits, kind, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shard")
    parser.add_argument("--view", type=int, help="which view to write as pictures")
    parser.add_argument("--out", default="view", help="what the pictures' names begin with")
    parser.add_argument("--without", type=int, help="leave out the object with this id")
    parser.add_argument("--alone", type=int, help="show the object with this id and nothing else")
    args = parser.parse_args()
    shard, views = open_shard(args.shard)
    if args.view is None:
        for v, view in enumerate(views):
            seen = ", ".join(f"{o['id']} {o['name']} ({o['visible_px']} of {o['alone_px']} px)" for o in view["objects"])
            held = np.argwhere(shard.get_tensor(f"{v:04}/relations"))
            ids = [o["id"] for o in view["objects"]]
            pairs = ", ".join(f"{ids[i]} {RELATIONS[r]} {ids[j]}" for i, j, r in held)
            print(f"{v}: scene {view['scene_seed']} view {view['view']} ({view['viewpoint']}): {seen}; {pairs}")
        return
    shown = lambda label: label == args.alone if args.alone is not None else label != args.without
    depth_m, labels, color = compose(shard, views, args.view, shown)
    write_png(f"{args.out}_depth.png", np.minimum(depth_m * 1e4 + 0.5, 65535).astype(np.uint16))
    write_png(f"{args.out}_labels.png", labels)
    if color is not None:
        write_png(f"{args.out}_color.png", color)


if __name__ == "__main__":
    main()

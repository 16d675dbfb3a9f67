#!/usr/bin/env python3
"""Reads Welkin's volume messages with the standard library alone, as proto/PROTOCOL.md describes them.

volume_reader.py VECTORS_DIR    decodes the test vectors and checks every value; exit code 0 if all hold
volume_reader.py FILE.bin       prints what a keyframe holds (say of GET /v1/worlds/w1/volume.bin)
"""

import json
import math
import pathlib
import struct
import sys
import zlib

VALUES_MAX = 1 << 26


class Bad(Exception):
    """A message that breaks a rule."""


def need(holds, why):
    if not holds:
        raise Bad(why)


def read_header(message):
    """The header with its table of channels, and the packed body."""
    need(len(message) >= 152, "too short")
    need(message[:4] == b"WLKV", "magic")
    (version, kind, compression, view, sequence, keyframe, mip, channel_count, header_bytes) = struct.unpack_from(
        "<HBBIIIBBH", message, 4
    )
    need(version == 1, "version")
    need(kind in (1, 2), "kind")
    need(compression in (0, 1, 2), "compression")
    need((keyframe == sequence) == (kind == 1) and keyframe <= sequence, "keyframe")
    tick, *floats = struct.unpack_from("<Q6d", message, 24)
    need(all(map(math.isfinite, floats)), "a time or a size")
    cell_size_m = floats[3:]
    world = struct.unpack_from("<3I", message, 80)
    first = struct.unpack_from("<3I", message, 92)
    size = struct.unpack_from("<3I", message, 104)
    brick = tuple(message[116:119])
    *sun_and_shift, body_bytes, raw_bytes, reserved = struct.unpack_from("<5f3I", message, 120)
    need(all(map(math.isfinite, sun_and_shift)), "sun or displacement")
    need(message[119] == 0 and reserved == 0, "reserved")
    need(mip <= 6, "mip")
    edge = 1 << mip
    for axis in range(3):
        end = first[axis] + size[axis]
        need(1 <= world[axis] <= 65536 and cell_size_m[axis] > 0, "world")
        need(size[axis] >= 1 and end <= world[axis], "region")
        need(first[axis] % edge == 0 and (end % edge == 0 or end == world[axis]), "region and mip")
        need(1 <= brick[axis] <= 64, "brick")
    need(1 <= channel_count <= 32, "channels")
    channels, at = [], 152
    for _ in range(channel_count):
        need(at + 20 <= len(message), "table")
        length, bits, curve, reserved, offset, scale = struct.unpack_from("<BBBBdd", message, at)
        name = message[at + 20 : at + 20 + length]
        at += 20 + length
        need(at <= len(message) and 1 <= length <= 64, "name")
        need(all(chr(c) in "abcdefghijklmnopqrstuvwxyz0123456789_" for c in name), "name")
        need(bits in (8, 16) and curve in (0, 1) and reserved == 0, "channel")
        need(0 <= scale <= 1e14 and abs(offset) <= 1e30 and (curve == 0 or offset == 0), "quantiser")
        channels.append({"name": name.decode(), "bits": bits, "curve": curve, "offset": offset, "scale": scale})
    need(len({c["name"] for c in channels}) == channel_count, "a name twice")
    need(at == header_bytes and len(message) - at == body_bytes, "lengths")
    header = {
        "kind": {1: "keyframe", 2: "delta"}[kind],
        "compression": compression,
        "view": view,
        "sequence": sequence,
        "keyframe": keyframe,
        "mip": mip,
        "tick": tick,
        "simulated_s": floats[0],
        "published_unix_s": floats[1],
        "encoded_unix_s": floats[2],
        "cell_size_m": cell_size_m,
        "world_cells": list(world),
        "region_from": list(first),
        "region_cells": list(size),
        "brick": list(brick),
        "cells": [-(-n // edge) for n in size],
        "sun_direction": sun_and_shift[:3],
        "air_displacement_m": sun_and_shift[3:],
        "raw_bytes": raw_bytes,
        "channels": channels,
    }
    return header, message[at:]


def unpack(compression, packed, raw_bytes):
    if compression == 0:
        raw = packed
    elif compression == 1:
        stream = zlib.decompressobj()
        try:
            raw = stream.decompress(packed, raw_bytes + 1)
        except zlib.error as error:
            raise Bad(f"zlib: {error}")
        need(stream.eof and not stream.unused_data, "zlib does not end with the body")
    else:
        raise NotImplementedError("the standard library has no zstd")
    need(len(raw) == raw_bytes, "unpacked length")
    return raw


def brick_cells(cells, brick):
    """For each brick its extents and where its cells lie in [z][y][x]."""
    nx, ny, nz = cells
    for z0 in range(0, nz, brick[2]):
        for y0 in range(0, ny, brick[1]):
            for x0 in range(0, nx, brick[0]):
                bx, by, bz = min(brick[0], nx - x0), min(brick[1], ny - y0), min(brick[2], nz - z0)
                places = [
                    ((z0 + z) * ny + y0 + y) * nx + x0 + x for z in range(bz) for y in range(by) for x in range(bx)
                ]
                yield (bx, by, bz), places


def read_channel(header, bits, raw, at, codes):
    """Reads a channel over `codes`; returns where the next begins."""
    bricks = list(brick_cells(header["cells"], header["brick"]))
    modes = raw[at : at + len(bricks)]
    need(len(modes) == len(bricks), "the body ends within a channel's bricks")
    at += len(bricks)
    for mode, ((bx, by, _), places) in zip(modes, bricks):
        need(mode <= (4 if header["kind"] == "delta" else 3), "mode")
        if mode == 0:
            continue
        count = 1 if mode == 1 else len(places)
        data = raw[at : at + count * bits // 8]
        need(len(data) == count * bits // 8, "the body ends within a brick")
        at += len(data)
        if bits == 16:
            data = [high << 8 | low for high, low in zip(data[:count], data[count:])]
        else:
            data = list(data)
        mask = (1 << bits) - 1
        if mode == 1:
            data *= len(places)
        elif mode == 4:
            data = [(codes[place] + change) & mask for place, change in zip(places, data)]
        elif mode == 3:
            for i in range(bx * by, count):
                data[i] = (data[i] + data[i - bx * by]) & mask
            for i in range(count):
                if i // bx % by:
                    data[i] = (data[i] + data[i - bx]) & mask
            for i in range(count):
                if i % bx:
                    data[i] = (data[i] + data[i - 1]) & mask
        for place, code in zip(places, data):
            codes[place] = code
    return at


def value(channel, code):
    step = code * channel["scale"]
    exact = channel["offset"] + (step * step if channel["curve"] else step)
    return struct.unpack("<f", struct.pack("<f", exact))[0]


class Receiver:
    """Holds the newest keyframe and the newest field; a field is (header, {channel: codes})."""

    def __init__(self):
        self.keyframe = None
        self.newest = None

    def take(self, message):
        """`field`, `stale` or `needs_keyframe`; raises Bad."""
        header, packed = read_header(message)
        if self.newest and self.newest[0]["view"] == header["view"] and self.newest[0]["sequence"] >= header["sequence"]:
            return "stale"
        base = None
        if header["kind"] == "delta":
            held = self.keyframe and (self.keyframe[0]["view"], self.keyframe[0]["sequence"])
            if held != (header["view"], header["keyframe"]):
                return "needs_keyframe"
            base = self.keyframe
            same = ("mip", "cell_size_m", "world_cells", "region_from", "region_cells", "brick", "channels")
            need(all(base[0][key] == header[key] for key in same), "a delta is not of its keyframe's shape")
        cells = math.prod(header["cells"])
        need(cells * len(header["channels"]) <= VALUES_MAX, "too many values")
        bricks = math.prod(-(-n // b) for n, b in zip(header["cells"], header["brick"]))
        most = sum(bricks + cells * c["bits"] // 8 for c in header["channels"])
        need(header["raw_bytes"] <= most, "the body is larger than its cells")
        raw = unpack(header["compression"], packed, header["raw_bytes"])
        field, at = {}, 0
        for channel in header["channels"]:
            codes = list(base[1][channel["name"]]) if base else [0] * cells
            at = read_channel(header, channel["bits"], raw, at, codes)
            field[channel["name"]] = codes
        need(at == len(raw), "bytes are left over")
        self.newest = (header, field)
        if header["kind"] == "keyframe":
            self.keyframe = self.newest
        return "field"

    def values(self, name):
        header, field = self.newest
        channel = next(c for c in header["channels"] if c["name"] == name)
        return [value(channel, code) for code in field[name]]


def check_vectors(directory):
    vectors = json.loads((directory / "vectors.json").read_text())
    checked = skipped = 0
    for vector in vectors["good"]:
        receiver, result = Receiver(), None
        try:
            for name in vector["messages"]:
                result = receiver.take((directory / name).read_bytes())
        except NotImplementedError:
            skipped += 1
            continue
        assert result == vector["result"], f"{vector['messages']}: {result}"
        checked += 1
        if result != "field":
            continue
        header = receiver.newest[0]
        for key, wanted in vector["header"].items():
            assert header[key] == wanted, f"{vector['messages']}: {key} is {header[key]}, not {wanted}"
        assert [c["name"] for c in header["channels"]] == list(vector["values"]), vector["messages"]
        for name, wanted in vector["values"].items():
            got = receiver.values(name)
            # The file's numbers are the shortest that name the single-precision values.
            wanted = [struct.unpack("<f", struct.pack("<f", v))[0] for v in wanted]
            assert got == wanted, f"{vector['messages']}: {name} differs"
    for vector in vectors["bad"]:
        try:
            Receiver().take((directory / vector["message"]).read_bytes())
        except Bad:
            checked += 1
        else:
            raise AssertionError(f"{vector['message']} was taken: {vector['why']}")
    print(f"{checked} vectors hold, {skipped} need zstd")


def show(path):
    receiver = Receiver()
    receiver.take(path.read_bytes())
    header, _ = receiver.newest
    print(f"tick {header['tick']}, {header['simulated_s']} simulated s, {header['cells']} cells at mip {header['mip']}")
    for channel in header["channels"]:
        values = receiver.values(channel["name"])
        mean = sum(values) / len(values)
        print(f"{channel['name']}: {min(values):g} to {max(values):g}, mean {mean:g}")


if __name__ == "__main__":
    target = pathlib.Path(sys.argv[1])
    check_vectors(target) if target.is_dir() else show(target)

// PNG as browsers write it: 8 bits a channel, with or without opacity, not interlaced.

import { inflateSync } from "node:zlib";

const CHANNELS = { 2: 3, 6: 4 };

/** Decodes to `{width, height, data}`, 4 bytes a pixel. */
export function decodePng(png) {
  const parts = [];
  let header;
  for (let at = 8; at < png.length;) {
    const length = png.readUInt32BE(at), type = png.toString("latin1", at + 4, at + 8), body = png.subarray(at + 8, at + 8 + length);
    if (type === "IHDR") header = { width: body.readUInt32BE(0), height: body.readUInt32BE(4), depth: body[8], color: body[9], interlaced: body[12] };
    if (type === "IDAT") parts.push(body);
    at += length + 12;
  }
  const { width, height, depth, color, interlaced } = header, channels = CHANNELS[color];
  if (depth !== 8 || !channels || interlaced) throw new Error(`a PNG of ${depth} bits, color type ${color}`);
  const packed = inflateSync(Buffer.concat(parts)), row = width * channels;
  const flat = new Uint8Array(row * height), data = new Uint8Array(4 * width * height);
  for (let y = 0; y < height; y++) unfilter(packed[y * (row + 1)], packed.subarray(y * (row + 1) + 1, (y + 1) * (row + 1)), flat, y, row, channels);
  for (let i = 0, j = 0; i < flat.length; i += channels, j += 4) {
    for (let k = 0; k < 3; k++) data[j + k] = flat[i + k];
    data[j + 3] = channels === 4 ? flat[i + 3] : 255;
  }
  return { width, height, data };
}

function unfilter(filter, packed, flat, y, row, channels) {
  for (let x = 0, at = y * row; x < row; x++, at++) {
    const left = x < channels ? 0 : flat[at - channels], up = y ? flat[at - row] : 0;
    let guess = 0;
    if (filter === 1) guess = left;
    else if (filter === 2) guess = up;
    else if (filter === 3) guess = (left + up) >> 1;
    else if (filter === 4) guess = paeth(left, up, y && x >= channels ? flat[at - row - channels] : 0);
    flat[at] = packed[x] + guess;
  }
}

function paeth(left, up, corner) {
  const guess = left + up - corner, a = Math.abs(guess - left), b = Math.abs(guess - up), c = Math.abs(guess - corner);
  return a <= b && a <= c ? left : b <= c ? up : corner;
}

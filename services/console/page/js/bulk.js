// The bulk form (safetensors): a length, a header in JSON, and tensors of little-endian numbers.

const ARRAYS = { U8: Uint8Array, U16: Uint16Array, F32: Float32Array };

/** Reads `{metadata, tensors}` from an ArrayBuffer; a tensor is a typed array. */
export function readBulk(buffer) {
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const { __metadata__: metadata = {}, ...described } = header;
  const tensors = {};
  for (const [name, { dtype, data_offsets: [start, end] }] of Object.entries(described)) {
    const Numbers = ARRAYS[dtype];
    if (!Numbers) throw new Error(`tensor ${name} is of type ${dtype}`);
    const at = 8 + length + start;
    const count = (end - start) / Numbers.BYTES_PER_ELEMENT;
    // Views must be aligned; what is not is copied.
    tensors[name] = at % Numbers.BYTES_PER_ELEMENT ? new Numbers(buffer.slice(at, 8 + length + end)) : new Numbers(buffer, at, count);
  }
  return { metadata, tensors };
}

/** Messages that come in parts, with others between them. */
export class Parts {
  #begun = new Map();

  /** Takes a part; the whole message as it would have come at once, text or an ArrayBuffer, when this was its last. */
  join({ metadata: { of, form, offset, total_bytes: total }, tensors: { bytes } }) {
    // One that is begun anew was given up before, with the cell that it was of.
    if (Number(offset) === 0) this.#begun.set(of, { whole: new Uint8Array(Number(total)), length: 0 });
    const begun = this.#begun.get(of);
    if (begun?.length !== Number(offset)) return undefined;
    begun.whole.set(bytes, begun.length);
    begun.length += bytes.length;
    if (begun.length < begun.whole.length) return undefined;
    this.#begun.delete(of);
    return form === "text" ? new TextDecoder().decode(begun.whole) : begun.whole.buffer;
  }
}

/** The scene of a message. */
export function sceneOf({ metadata, tensors }) {
  const meta = JSON.parse(metadata.scene), { width, height } = meta.camera;
  return { id: metadata.scene_id, camera: metadata.camera, grid: JSON.parse(metadata.grid), meta, width, height, tensors, objects: new Map(meta.objects.map((object) => [object.id, object])) };
}

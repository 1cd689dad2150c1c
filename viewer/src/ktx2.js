// SPDX-License-Identifier: MIT
// Reader of KTX 2.0 files: 2D, arrays, 3D; plain, or each level a zstd frame.
import { decompress } from '../vendor/fzstd.js';

const SIGNATURE = [0xab, 0x4b, 0x54, 0x58, 0x20, 0x32, 0x30, 0xbb, 0x0d, 0x0a, 0x1a, 0x0a];
const MOST_LEVELS = 16;

export function readKtx2(bytes, name) {
  const fail = (what) => { throw new Error(`${name}: ${what}`); };
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 104 || SIGNATURE.some((b, i) => bytes[i] !== b)) fail('not a KTX 2.0 file');
  const u32 = (at) => view.getUint32(at, true), u64 = (at) => Number(view.getBigUint64(at, true));
  const levelCount = Math.max(1, u32(40)), scheme = u32(44);
  if (levelCount > MOST_LEVELS || bytes.length < 80 + 24 * levelCount) fail('its level index is cut short');
  if (scheme !== 0 && scheme !== 2) fail(`supercompression ${scheme}; only zstd is read`);
  const levels = [];
  for (let i = 0; i < levelCount; i++) {
    const at = 80 + 24 * i, offset = u64(at), length = u64(at + 8), plainLength = u64(at + 16);
    if (offset + length > bytes.length) fail(`level ${i} lies beyond the end of the file`);
    const stored = bytes.subarray(offset, offset + length);
    const data = scheme === 2 ? decompress(stored, new Uint8Array(plainLength)) : stored;
    if (data.length !== plainLength) fail(`level ${i} has ${data.length} bytes, not ${plainLength}`);
    levels.push(data);
  }
  return { format: u32(12), width: u32(20), height: Math.max(1, u32(24)), depth: Math.max(1, u32(28)),
    layers: Math.max(1, u32(32)), faces: u32(36), levels };
}

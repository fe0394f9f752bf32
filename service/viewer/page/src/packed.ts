// Numbers and hulls as service/viewer packs them into a page: bytes in base64, points on a grid of 65,536 steps.
export interface Packed { dtype: string; shape: number[]; data: string }
export interface Quantized extends Packed { lower: number[]; upper: number[] }
export interface PackedHull { vertices: Packed; triangles: Packed; edges: Packed; bends: Packed }
export interface Hull { vertices: Float32Array; triangles: Uint16Array; edges: Uint16Array; bends: Uint8Array }

export function bytesOf(packed: Packed): ArrayBuffer {
  const text = atob(packed.data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
}

export const floats = (packed: Packed): Float32Array => new Float32Array(bytesOf(packed));
export const indices = (packed: Packed): Uint16Array => new Uint16Array(bytesOf(packed));

export function points(packed: Quantized): Float32Array {
  const grid = indices(packed);
  return Float32Array.from(grid, (value, i) => {
    const lower = packed.lower[i % 3];
    return lower + (value / 65535) * (packed.upper[i % 3] - lower);
  });
}

export const hullOf = (hull: PackedHull): Hull => ({
  vertices: floats(hull.vertices), triangles: indices(hull.triangles), edges: indices(hull.edges),
  bends: new Uint8Array(bytesOf(hull.bends)),
});

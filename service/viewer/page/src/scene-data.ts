// The payload that service/scene_view/payload.py wrote, decoded into typed arrays.
import { Hull, Packed, PackedHull, Quantized, bytesOf, hullOf, points } from "./packed";

export interface Facts { points: number; free_cells: number; free_share: number; open_share: number }
// How a piece stands to those of the scan before; null where there was none.
export type Change = "stayed" | "changed" | "new" | null;
export interface Piece { name: string; kind: string; facts: Facts | null; change: Change; hull: Hull }
export interface Hit {
  kind: string; confidence: number; pose_world_object: number[][]; sizes: Record<string, number>;
  residuals: Record<string, number>; points: Float32Array;
}
export interface KnownMesh {
  name: string; file: string; placing: string; confidence: number; pose_world_mesh: number[][] | null;
  residuals: Record<string, number>; pieces: string[];
}
// One bit for each cell: rays went through it, or points were measured in it; neither, and nobody has seen it.
export interface Space { lower: number[]; size: number; shape: number[]; free: Uint8Array; occupied: Uint8Array }
export interface Scan {
  title: string; figures: Record<string, number>; notes: string[]; kinds: string[]; pieces: Piece[]; detections: Hit[];
  meshes: KnownMesh[]; cloud: Float32Array; owner: Uint16Array; sensors: number[][]; space: Space;
}

interface Payload extends Omit<Scan, "pieces" | "detections" | "cloud" | "owner" | "space"> {
  pieces: (Omit<Piece, "hull"> & { hull: PackedHull })[];
  detections: (Omit<Hit, "points"> & { points: Quantized })[];
  cloud: Quantized; owner: Packed; space: Omit<Space, "free" | "occupied"> & { free: Packed; occupied: Packed };
}

// What points without a piece belong to, as payload.py numbers them.
export const NOBODYS = 65535;
export const FLOORS = 65534;
export const LEFT_OUT = 65533;

export function readScan(): Scan {
  const payload = JSON.parse(document.getElementById("payload")!.textContent) as Payload;
  return {
    ...payload,
    pieces: payload.pieces.map((piece) => ({ ...piece, hull: hullOf(piece.hull) })),
    detections: payload.detections.map((hit) => ({ ...hit, points: points(hit.points) })),
    cloud: points(payload.cloud),
    owner: new Uint16Array(bytesOf(payload.owner)),
    space: {
      ...payload.space, free: new Uint8Array(bytesOf(payload.space.free)), occupied: new Uint8Array(bytesOf(payload.space.occupied)),
    },
  };
}

// The payload that service/scene_view/payload.py wrote, decoded into typed arrays.
import { Hull, Packed, PackedHull, Quantized, bytesOf, hullOf, points } from "./data";

export interface Facts { points: number; free_cells: number; free_share: number; open_share: number }
export interface Piece { name: string; kind: string; facts: Facts | null; hull: Hull }
export interface Hit {
  kind: string; confidence: number; pose_world_object: number[][]; sizes: Record<string, number>;
  residuals: Record<string, number>; points: Float32Array;
}
export interface Free { lower: number[]; size: number; shape: number[]; bits: Uint8Array }
export interface Scan {
  title: string; figures: Record<string, number>; notes: string[]; kinds: string[]; pieces: Piece[]; detections: Hit[];
  cloud: Float32Array; owner: Uint16Array; sensors: number[][]; free: Free;
}

interface Payload extends Omit<Scan, "pieces" | "detections" | "cloud" | "owner" | "free"> {
  pieces: (Omit<Piece, "hull"> & { hull: PackedHull })[];
  detections: (Omit<Hit, "points"> & { points: Quantized })[];
  cloud: Quantized; owner: Packed; free: Omit<Free, "bits"> & { bits: Packed };
}

// What points without a piece belong to, as payload.py numbers them.
export const NOBODYS = 65535;
export const FLOORS = 65534;
export const LEFT_OUT = 65533;

export function readScan(): Scan {
  const payload = JSON.parse(document.getElementById("payload")!.textContent!) as Payload;
  return {
    ...payload,
    pieces: payload.pieces.map((piece) => ({ ...piece, hull: hullOf(piece.hull) })),
    detections: payload.detections.map((hit) => ({ ...hit, points: points(hit.points) })),
    cloud: points(payload.cloud),
    owner: new Uint16Array(bytesOf(payload.owner)),
    free: { ...payload.free, bits: new Uint8Array(bytesOf(payload.free.bits)) },
  };
}

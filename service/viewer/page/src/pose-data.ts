// The graph of poses that service/viewer/pose_graph.py wrote: phases, poses with their costs, the chosen path.
import { Matrix4, Quaternion, Vector3 } from "three";
import { Packed, Quantized, bytesOf, points } from "./packed";

export interface SampledPhase {
  name: string; solved: number; feasible: number; duplicates: number; failures: [string, number][]; other_failures: number;
}
// Phase by index; cost_to_end is null where no sequence leads to the end; drawn is the row of its links, -1 without one.
export interface PoseNode { phase: number; place: number; cost: number; cost_to_end: number | null; drawn: number }
interface Drawn<Positions, Rotations> {
  phases: SampledPhase[]; poses: PoseNode[]; left_out: number; path: number[]; cost: number | null; slip_m: number | null;
  not_linked: string[]; links: string[]; positions: Positions; rotations: Rotations;
}
export type PackedPoseGraph = Drawn<Quantized, Packed>;
export type PoseGraph = Drawn<Float32Array, Int16Array>;

const ONE = new Vector3(1, 1, 1);

export function readPoseGraph(packed: PackedPoseGraph): PoseGraph {
  return { ...packed, positions: points(packed.positions), rotations: new Int16Array(bytesOf(packed.rotations)) };
}

// Pose of a link in the world at a pose that is drawn.
export function poseOfLink(graph: PoseGraph, pose: PoseNode, link: number): Matrix4 {
  const k = pose.drawn * graph.links.length + link;
  const r = graph.rotations;
  const rotation = new Quaternion(r[4 * k + 1], r[4 * k + 2], r[4 * k + 3], r[4 * k]).normalize();
  return new Matrix4().compose(new Vector3().fromArray(graph.positions, 3 * k), rotation, ONE);
}

// The pose of a phase on the chosen path; -1 without one.
export function chosenIn(graph: PoseGraph, phase: number): number {
  return graph.path.find((pose) => graph.poses[pose]?.phase === phase) ?? -1;
}

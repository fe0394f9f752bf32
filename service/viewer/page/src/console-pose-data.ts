// A pose that is led: what the bridge sends of it (service/cli/console/posing.py), where joints put shapes, and the keys.
import { Matrix4, Quaternion, Vector3 } from "three";
import type { PackedHull } from "./packed";

export interface Drawing {
  joints: { parent: number; rest: number[]; motion: number[]; at: number }[];
  bodies: { name: string; link: string; joint: number; hull: PackedHull }[];
  frames: { name: string; joint: number; pose: number[] }[];
  tools: Record<string, string>;
}
export interface Pose {
  number: number; revision: number; is_checked: boolean; base: number[]; positions: number[];
  stops: { kind: string; text: string }[]; undo: number; redo: number; refusal: string;
  clearance_m: number | null; balance_margin_m: number | null; torque_share: number | null;
}
export interface OpenedPose { session: number; joint_names: string[]; links: string[]; feet: string[]; notes: string[]; pose: Pose; drawing: Drawing }
export interface Measured { clock_s: number; farthest: { joint: string; off: number } | null; base: number[]; positions: number[] }
export interface Target { link: string; position: number[]; quaternion_wxyz: number[] | null }
export type Hand = "left" | "right" | "both";

const matrixOf = (pose: number[]): Matrix4 => new Matrix4().compose(
  new Vector3().fromArray(pose), new Quaternion(pose[4], pose[5], pose[6], pose[3]).normalize(), new Vector3(1, 1, 1),
);

// The motion of a screw (velocity, angular velocity) by an amount.
export function screw(motion: number[], amount: number): Matrix4 {
  const v = new Vector3().fromArray(motion).multiplyScalar(amount);
  const w = new Vector3().fromArray(motion, 3).multiplyScalar(amount);
  const angle = w.length();
  if (angle < 1e-9) return new Matrix4().makeTranslation(v);
  const once = w.clone().cross(v);
  const twice = w.clone().cross(once);
  const shift = v.clone().addScaledVector(once, (1 - Math.cos(angle)) / angle ** 2).addScaledVector(twice, (angle - Math.sin(angle)) / angle ** 3);
  return new Matrix4().makeRotationAxis(w.divideScalar(angle), angle).setPosition(shift);
}

// Poses of all joints in the world, from 1; 0 is the world.
export function placeJoints({ joints }: Drawing, base: number[], positions: number[]): Matrix4[] {
  const placed = [new Matrix4()];
  for (const { parent, rest, motion, at } of joints) {
    const own = matrixOf(rest.length > 0 ? rest : base);
    if (motion.length > 0) own.multiply(screw(motion, positions[at]));
    placed.push(placed[parent].clone().multiply(own));
  }
  return placed;
}

export function placeFrame(drawing: Drawing, placed: Matrix4[], name: string): Matrix4 | undefined {
  const frame = drawing.frames.find((one) => one.name === name);
  return frame && placed[frame.joint].clone().multiply(matrixOf(frame.pose));
}

// Point between the tools of both hands, about which both turn; null where there are not two.
export function middleOfHands(drawing: Drawing, placed: Matrix4[]): number[] | null {
  const places = ["left", "right"].map((side) => placeFrame(drawing, placed, drawing.tools[side] ?? ""));
  const [left, right] = places.map((place) => place && new Vector3().setFromMatrixPosition(place));
  return left && right ? left.add(right).multiplyScalar(0.5).toArray() : null;
}

// Positions by name in the order of other names; null where one is missing.
export function inOrder(names: string[], values: number[], wanted: string[]): number[] | null {
  const known = new Map(names.map((name, i) => [name, values[i]]));
  const ordered = wanted.map((name) => known.get(name));
  return ordered.every((value) => value !== undefined) ? (ordered) : null;
}

export interface Key { key: string; text: string; does: string }
export const KEYS: Key[] = [
  { key: "Up", text: "↑", does: "up" }, { key: "Down", text: "↓", does: "down" }, { key: "Left", text: "←", does: "left" },
  { key: "Right", text: "→", does: "right" }, { key: "o", text: "o", does: "out" }, { key: "i", text: "i", does: "in" },
  { key: "e", text: "e", does: "pitch up" }, { key: "d", text: "d", does: "pitch down" }, { key: "s", text: "s", does: "yaw left" },
  { key: "f", text: "f", does: "yaw right" }, { key: "w", text: "w", does: "roll left" }, { key: "r", text: "r", does: "roll right" },
  { key: "q", text: "q", does: "neck up" }, { key: "a", text: "a", does: "neck down" },
];
const TURNS = "EDSFWR";

// Key of the map that a pressed key means; null for any other. Capitals turn about the world's axes.
export function readKey(pressed: string): string | null {
  const name = pressed.replace(/^Arrow/, "");
  return KEYS.some(({ key }) => key === name) || (name.length === 1 && TURNS.includes(name)) ? name : null;
}

// What a mode of direct moves asks for, and the step of task.steps that it makes.
export interface MoveForm { name: string; fields: [string, string, string][]; make(values: number[][], hand: Record<string, unknown>): Record<string, unknown> }
const one = (values: number[][], k: number): number => values[k][0];
export const MOVES: MoveForm[] = [
  {
    name: "line", fields: [["shift", "m", "0, 0, 0.05"], ["turn", "deg", "0, 0, 0"]],
    make: ([translation, rotation_deg], hand) => ({ move: { ...hand, along: "line", by: { translation, rotation_deg } } }),
  },
  {
    name: "circle", fields: [["centre", "m", "0.5, 0, 1"], ["axis", "", "1, 0, 0"], ["angle", "deg", "20"]],
    make: (values, hand) => ({ screw: { ...hand, centre: values[0], axis: values[1], rotation_deg: one(values, 2) } }),
  },
  {
    name: "plunge", fields: [["depth", "m", "0.05"]],
    make: (values, hand) => ({ screw: { ...hand, axis: [0, 0, 1], axes: "hand", translation_m: one(values, 0) } }),
  },
  {
    name: "body", fields: [["pelvis", "m", "0, 0, -0.05"], ["pelvis turn", "deg", "0, 0, 0"], ["torso turn", "deg", "0, 0, 0"]],
    make: ([pelvis_m, pelvis_rpy_deg, torso_rpy_deg]) => ({ body: { pelvis_m, pelvis_rpy_deg, torso_rpy_deg } }),
  },
];

// Regions that a link has to end or stay in: bounds along axes, a cylinder, a ball, the lean of an axis, a place to look at.
import {
  BoxGeometry, BufferGeometry, ConeGeometry, CylinderGeometry, EdgesGeometry, Group, LineBasicMaterial, LineSegments, Material,
  Mesh, Quaternion, SphereGeometry, Vector3,
} from "three";
import { Target } from "./data";

const OPEN_M = 0.5;  // how far a region is drawn where nothing bounds it
const LEAST_M = 0.002;  // thickness of one that is drawn flat
const CONE_M = 0.15;

export interface Span3 { low: number[]; high: number[] }

// The drawn extent of a region along its axes, from the origin; null where its place is free.
export function extentOf(target: Target): Span3 | null {
  const lower = target.lower_m ?? [null, null, null], upper = target.upper_m ?? [null, null, null];
  const reach = target.distance_m ?? null, radius = target.radius_m ?? null;
  if ([...lower, ...upper].every((bound) => bound === null) && reach === null && radius === null) return null;
  const low: number[] = [], high: number[] = [];
  for (let k = 0; k < 3; k += 1) {
    const across = k < 2 && radius !== null ? radius : reach;
    const from = lower[k] ?? (across === null ? Math.min(upper[k] ?? 0, 0) - OPEN_M : -across);
    const to = upper[k] ?? (across === null ? Math.max(lower[k] ?? 0, 0) + OPEN_M : across);
    const spare = Math.max(LEAST_M - (to - from), 0) / 2;
    low.push(from - spare);
    high.push(to + spare);
  }
  return { low, high };
}

function solid(group: Group, geometry: BufferGeometry, fill: Material, line: LineBasicMaterial): void {
  group.add(new Mesh(geometry, fill), new LineSegments(new EdgesGeometry(geometry, 30), line));
}

// Draw a region of the world; its group has the region's place and axes.
export function drawRegion(target: Target, fill: Material, line: LineBasicMaterial): Group {
  const group = new Group();
  const [w, x, y, z] = target.quaternion_wxyz ?? [1, 0, 0, 0];
  group.position.fromArray(target.position ?? [0, 0, 0]);
  group.quaternion.set(x, y, z, w).normalize();
  const extent = extentOf(target);
  if (extent) {
    const size = extent.high.map((high, k) => high - extent.low[k]);
    const middle = extent.high.map((high, k) => (high + extent.low[k]) / 2);
    const isBall = target.distance_m != null && !(target.lower_m ?? []).some((bound) => bound !== null)
      && !(target.upper_m ?? []).some((bound) => bound !== null) && target.radius_m == null;
    let geometry: BufferGeometry;
    if (isBall) geometry = new SphereGeometry(Math.max(target.distance_m!, 0.004), 24, 16);
    else if (target.radius_m != null) geometry = new CylinderGeometry(target.radius_m, target.radius_m, size[2], 32).rotateX(Math.PI / 2);
    else geometry = new BoxGeometry(size[0], size[1], size[2]);
    const isRound = isBall || target.radius_m != null;
    geometry.translate(isRound ? 0 : middle[0], isRound ? 0 : middle[1], isBall ? 0 : middle[2]);
    solid(group, geometry, fill, line);
  }
  if (target.look) {
    const place = new SphereGeometry(0.015, 16, 8).translate(target.look[0], target.look[1], target.look[2]);
    group.add(new Mesh(place, line));
  } else if (target.axis && target.lean_deg != null && target.lean_deg < 89) {
    const radius = CONE_M * Math.tan((target.lean_deg * Math.PI) / 180);
    // The cone's tip is at the origin, its axis that of the link in the wanted orientation.
    const cone = new ConeGeometry(radius, CONE_M, 32, 1, true).rotateX(Math.PI).translate(0, CONE_M / 2, 0);
    const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), new Vector3().fromArray(target.axis).normalize());
    cone.applyQuaternion(turn);
    solid(group, cone, fill, line);
  }
  return group;
}

// What the hands are asked to reach.
import {
  BufferGeometry, ConeGeometry, CylinderGeometry, Group, LineBasicMaterial, Material, Mesh, MeshBasicMaterial, Quaternion, SphereGeometry, TorusGeometry,
  Vector3,
} from "three";
import { Phase, Result, Target } from "./data";
import { drawRegion } from "./goal-regions";
import { Layer } from "./layer";
import { Label } from "./labels";
import { Colours } from "./theme";

const UP = new Vector3(0, 1, 0);
const FRAME = [["#ef4444", [1, 0, 0]], ["#22c55e", [0, 1, 0]], ["#3b82f6", [0, 0, 1]]] as const;

function arrow(direction: Vector3, length: number, radius: number, material: Material): Group {
  const group = new Group();
  const shaft = new CylinderGeometry(radius, radius, length, 10).translate(0, length / 2, 0);
  const tip = new ConeGeometry(3 * radius, 8 * radius, 12).translate(0, length, 0);
  group.add(new Mesh(shaft, material), new Mesh(tip, material));
  group.quaternion.setFromUnitVectors(UP, direction.clone().normalize());
  return group;
}

export class Targets implements Layer {
  readonly name = "targets";
  readonly label = "Targets";
  readonly key = "t";
  readonly group = new Group();
  readonly labels: Label[] = [];
  private readonly ring = new MeshBasicMaterial();
  private readonly tolerance = new MeshBasicMaterial({ transparent: true, opacity: 0.22, depthWrite: false });
  private readonly edge = new LineBasicMaterial();
  private readonly drawn: { group: Group; phases: Phase[]; label: Label }[] = [];

  constructor(result: Result) {
    const seen = new Map<string, Phase[]>();
    // The goal of a motion that was never planned stands all the time.
    const goal: Phase = { name: "goal", start: -Infinity, end: Infinity, targets: result.obstruction?.targets ?? [], regions: [] };
    for (const phase of [...result.phases, goal]) {
      for (const target of phase.targets ?? []) {
        const same = seen.get(JSON.stringify(target));
        if (same) { same.push(phase); continue; }
        const phases = [phase];
        seen.set(JSON.stringify(target), phases);
        this.add(target, phases);
      }
    }
  }

  get count(): number { return this.drawn.length; }

  private add(target: Target, phases: Phase[]): void {
    const group = new Group();
    let at: Vector3;
    let text: string;
    if (target.kind === "circle" && target.centre && target.axis && target.radius) {
      at = this.circle(group, target);
      text = `${target.frame ?? "circle"} · r ${(1000 * target.radius).toFixed(0)} mm`;
    } else if (target.kind === "pose" && target.position) {
      at = new Vector3().fromArray(target.position);
      const [w, x, y, z] = target.quaternion_wxyz ?? [1, 0, 0, 0];
      const turn = new Quaternion(x, y, z, w).normalize();
      for (const [colour, axis] of FRAME) {
        const direction = new Vector3().fromArray(axis).applyQuaternion(turn);
        const needle = arrow(direction, 0.12, 0.005, new MeshBasicMaterial({ color: colour }));
        needle.position.copy(at);
        group.add(needle);
      }
      const knot = new Mesh(new SphereGeometry(0.012, 16, 8), this.ring);
      knot.position.copy(at);
      group.add(knot);
      text = `${target.frame ?? "pose"} · ${phases[0].name}`;
    } else if (target.kind === "region" && !target.reference && target.position) {
      const region = drawRegion(target, this.tolerance, this.edge);
      group.add(region);
      at = region.position.clone();
      text = `${target.frame ?? "region"} · ${phases[0].name}`;
    } else {
      return;
    }
    const label: Label = { at, text, kind: "target", isOn: true };
    this.labels.push(label);
    this.drawn.push({ group, phases, label });
    this.group.add(group);
  }

  private circle(group: Group, target: Target): Vector3 {
    const centre = new Vector3().fromArray(target.centre!);
    const axis = new Vector3().fromArray(target.axis!).normalize();
    const upright = new Quaternion().setFromUnitVectors(new Vector3(0, 0, 1), axis);
    const rings: [BufferGeometry, Material][] = [[new TorusGeometry(target.radius, 0.0035, 8, 96), this.ring]];
    if (target.tolerance_m) rings.push([new TorusGeometry(target.radius, target.tolerance_m, 10, 96), this.tolerance]);
    for (const [geometry, material] of rings) {
      const ring = new Mesh(geometry, material);
      ring.position.copy(centre);
      ring.quaternion.copy(upright);
      group.add(ring);
    }
    const needle = arrow(axis, 0.16, 0.004, this.ring);
    needle.position.copy(centre);
    group.add(needle);
    // The label sits on top of the ring, where the hand is least.
    const top = new Vector3(0, 0, 1).projectOnPlane(axis);
    return centre.addScaledVector(top.length() > 1e-3 ? top.normalize() : new Vector3(1, 0, 0), target.radius! + 0.02);
  }

  // Only what the current phase asks for; before and after the motion everything.
  update(t: number): void {
    for (const { group, phases, label } of this.drawn) {
      group.visible = label.isOn = phases.some((phase) => t >= phase.start - 1e-6 && t <= phase.end + 1e-6);
    }
  }

  recolour(colours: Colours): void {
    this.ring.color.set(colours.target);
    this.tolerance.color.set(colours.target);
    this.edge.color.set(colours.target);
  }
}

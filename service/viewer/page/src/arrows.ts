// Arrows that show forces to scale, over everything in front of them.
import { ConeGeometry, CylinderGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial, Vector3 } from "three";

const UP = new Vector3(0, 1, 0);
const LONGEST = 0.35;

export const overlay = (opacity: number): MeshBasicMaterial =>
  new MeshBasicMaterial({ transparent: true, opacity, depthTest: false, depthWrite: false, side: DoubleSide });

export class Arrow {
  readonly group = new Group();
  private readonly shaft: Mesh;
  private readonly tip: Mesh;

  constructor(material: MeshBasicMaterial, private readonly radius: number) {
    this.shaft = new Mesh(new CylinderGeometry(radius, radius, 1, 10).translate(0, 0.5, 0), material);
    this.tip = new Mesh(new ConeGeometry(2.6 * radius, 1, 14).translate(0, -0.5, 0), material);
    for (const mesh of [this.shaft, this.tip]) mesh.renderOrder = 12;
    this.group.add(this.shaft, this.tip);
  }

  // From a place along a vector, both in metres; the tip ends where the vector does.
  set(from: Vector3, vector: Vector3): void {
    const length = vector.length();
    this.group.visible = length > 1e-4;
    if (!this.group.visible) return;
    const head = Math.min(7 * this.radius, 0.6 * length);
    this.group.position.copy(from);
    this.group.quaternion.setFromUnitVectors(UP, vector.clone().divideScalar(length));
    this.shaft.scale.y = length - head;
    this.tip.scale.y = head;
    this.tip.position.y = length;
  }
}

// A round number of newtons per metre, at which the largest force is drawn no longer than LONGEST.
export function forceScale(largest: number): number {
  const least = Math.max(largest, 1e-6) / LONGEST;
  const decade = 10 ** Math.floor(Math.log10(least));
  return decade * ([1, 2, 5].find((digit) => digit * decade >= least * (1 - 1e-9)) ?? 10);
}

export const scaleText = (newtonsPerMetre: number): string => `10 cm: ${Number((newtonsPerMetre / 10).toPrecision(2))} N`;

// A robot whose joints are placed by the numbers of a pose: the ghost that is led, and the robot as it is measured.
import { Box3, Group, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshStandardMaterial } from "three";
import { Drawing, placeFrame, placeJoints } from "./console-pose-data";
import { edgeGeometry, hullGeometry } from "./geometry";
import { hullOf } from "./packed";

export class JointedRobot {
  readonly group = new Group();
  placed: Matrix4[] = [];
  private readonly parts: { joint: number; group: Group }[] = [];
  private readonly material: MeshStandardMaterial;
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.5, vertexColors: true });

  constructor(readonly drawing: Drawing, colour: string, opacity: number) {
    this.material = new MeshStandardMaterial({
      color: colour, flatShading: true, roughness: 0.62, metalness: 0.08, transparent: opacity < 1, opacity, depthWrite: opacity === 1,
    });
    this.edges.color.set("#0b0e13");
    for (const { joint, hull } of drawing.bodies) {
      const shape = hullOf(hull);
      const part = new Group();
      const mesh = new Mesh(hullGeometry(shape), this.material);
      mesh.castShadow = opacity === 1;
      part.matrixAutoUpdate = false;
      part.add(mesh, new LineSegments(edgeGeometry([shape]), this.edges));
      this.parts.push({ joint, group: part });
      this.group.add(part);
    }
  }

  set(base: number[], positions: number[]): void {
    this.placed = placeJoints(this.drawing, base, positions);
    for (const { joint, group } of this.parts) {
      group.matrix.copy(this.placed[joint]);
      group.matrixWorldNeedsUpdate = true;
    }
  }

  // A pose that the verifier has not checked is drawn paler.
  tint(colour: string): void { this.material.color.set(colour); }

  frame(name: string): Matrix4 | undefined { return placeFrame(this.drawing, this.placed, name); }

  box(): Box3 {
    this.group.updateMatrixWorld(true);
    return new Box3().setFromObject(this.group);
  }
}

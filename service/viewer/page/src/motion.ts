// Poses of the links of the robot and of what is moved, at any time: linear in position, along the shorter arc in rotation.
import { Matrix4, Quaternion, Vector3 } from "three";
import { Result, frameAt } from "./data";

const ONE = new Vector3(1, 1, 1);

export class Motion {
  readonly start: number;
  readonly end: number;

  constructor(private readonly result: Result) {
    this.start = result.times[0] ?? 0;
    this.end = result.times.at(-1) ?? 0;
  }

  get nFrames(): number { return this.result.times.length; }
  get links(): string[] { return this.result.links; }

  private frame(frame: number, link: number, position: Vector3, rotation: Quaternion): void {
    const k = frame * this.links.length + link;
    const r = this.result.rotations;
    position.fromArray(this.result.positions, 3 * k);
    rotation.set(r[4 * k + 1], r[4 * k + 2], r[4 * k + 3], r[4 * k]).normalize();
  }

  pose(link: number, t: number, position: Vector3, rotation: Quaternion): void {
    const [frame, u] = frameAt(this.result.times, t);
    this.frame(frame, link, position, rotation);
    if (u > 0) {
      const nextPosition = new Vector3();
      const nextRotation = new Quaternion();
      this.frame(frame + 1, link, nextPosition, nextRotation);
      position.lerp(nextPosition, u);
      rotation.slerp(nextRotation, u);
    }
  }

  matrix(link: number, t: number): Matrix4 {
    const position = new Vector3();
    const rotation = new Quaternion();
    this.pose(link, t, position, rotation);
    return new Matrix4().compose(position, rotation, ONE);
  }

  place(name: string, t: number): Vector3 | undefined {
    const link = this.links.indexOf(name);
    return link < 0 || this.nFrames === 0 ? undefined : new Vector3().setFromMatrixPosition(this.matrix(link, t));
  }

  timeOfFrame(frame: number): number { return this.result.times[frame]; }

  // How far a link's origin travels over the whole motion [m].
  travel(link: number): number {
    let length = 0;
    const a = new Vector3();
    const b = new Vector3();
    for (let frame = 1; frame < this.nFrames; frame++) {
      a.fromArray(this.result.positions, 3 * ((frame - 1) * this.links.length + link));
      b.fromArray(this.result.positions, 3 * (frame * this.links.length + link));
      length += a.distanceTo(b);
    }
    return length;
  }
}

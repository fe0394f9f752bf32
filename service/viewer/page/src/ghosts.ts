// Every waypoint as a ghost: coloured by its time, fading with its distance in time from now.
import {
  Group, InstancedBufferAttribute, InstancedMesh, Matrix4, NotEqualStencilFunc, ShaderMaterial, Vector3,
} from "three";
import { Body } from "./data";
import { smoothHullGeometry } from "./geometry";
import { Layer } from "./layer";
import { Motion } from "./motion";
import { Colours, timeColour } from "./theme";

export const VERTEX = `
attribute vec3 tint;
attribute float strength;
varying vec3 vView;
varying vec3 vNormal;
varying vec3 vTint;
varying float vStrength;
void main() {
  vec4 place = modelViewMatrix * instanceMatrix * vec4(position, 1.0);
  vView = place.xyz;
  vNormal = normalMatrix * mat3(instanceMatrix) * normal;
  vTint = tint;
  vStrength = strength;
  gl_Position = projectionMatrix * place;
}`;

// What faces the eye stays thin, what turns away glows: outlines read, what lies behind is not hidden.
export const FRAGMENT = `
uniform float gain;
varying vec3 vView;
varying vec3 vNormal;
varying vec3 vTint;
varying float vStrength;
void main() {
  if (vStrength < 0.004) discard;
  float slant = 1.0 - abs(dot(normalize(vNormal), normalize(vView)));
  gl_FragColor = vec4(vTint, min(0.85, gain * vStrength * (0.10 + 0.90 * pow(slant, 2.2))));
  #include <colorspace_fragment>
}`;

interface Part {
  mesh: InstancedMesh; strength: InstancedBufferAttribute; poses: Matrix4[]; link: number; radius: number; fresh: boolean[];
}

// Largest displacement between two poses of points within radius of the link's origin [m].
function displacement(a: Matrix4, b: Matrix4, radius: number): number {
  const p = a.elements;
  const q = b.elements;
  let turn = 0;
  const gap = (column: number): number =>
    Math.hypot(p[column] - q[column], p[column + 1] - q[column + 1], p[column + 2] - q[column + 2]);
  for (const axis of [0, 4, 8]) turn = Math.max(turn, gap(axis));
  return gap(12) + turn * radius;
}

export class Ghosts implements Layer {
  readonly name = "ghosts";
  readonly label = "Waypoint ghosts";
  readonly key = "g";
  readonly group = new Group();
  readonly times: number[];
  private readonly parts: Part[] = [];
  private readonly material = new ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: { gain: { value: 1 } },
    transparent: true, depthWrite: false, stencilWrite: true, stencilRef: 1, stencilFunc: NotEqualStencilFunc,
  });
  private focus = -1;
  private now = 0;
  private gain = 1;
  private readonly share: number;

  constructor(bodies: Body[], private readonly motion: Motion, waypoints: number[]) {
    this.times = motion.nFrames > 0 ? waypoints.map((frame) => motion.timeOfFrame(frame)) : [];
    // Many ghosts overlap: together they stay as light as a few.
    this.share = Math.min(1, Math.max(14 / Math.max(this.times.length, 1), 0.2));
    if (this.times.length === 0) return;
    const span = Math.max(motion.end - motion.start, 1e-9);
    const tints = new Float32Array(this.times.flatMap((t) => timeColour((t - motion.start) / span).toArray()));
    for (const body of bodies) {
      const link = motion.links.indexOf(body.link);
      const geometry = smoothHullGeometry(body.hull);
      const strength = new InstancedBufferAttribute(new Float32Array(this.times.length), 1);
      geometry.setAttribute("tint", new InstancedBufferAttribute(tints, 3));
      geometry.setAttribute("strength", strength);
      const mesh = new InstancedMesh(geometry, this.material, this.times.length);
      mesh.frustumCulled = false;
      mesh.renderOrder = 4;
      const poses = this.times.map((t) => motion.matrix(link, t));
      poses.forEach((pose, i) => mesh.setMatrixAt(i, pose));
      const sphere = geometry.boundingSphere!;
      const radius = sphere.center.distanceTo(new Vector3()) + sphere.radius;
      // A body that stands still is drawn once, not as often as there are waypoints.
      let kept = poses[0];
      const fresh = poses.map((pose, i) => {
        const moved = i === 0 || displacement(pose, kept, radius) > 0.012;
        if (moved) kept = pose;
        return moved;
      });
      this.parts.push({ mesh, strength, poses, link, radius, fresh });
      this.group.add(mesh);
    }
  }

  get count(): number { return this.times.length; }

  // Show one ghost strongly (or none: -1).
  setFocus(index: number): void {
    this.focus = index;
    this.update(this.now);
  }

  update(t: number): void {
    this.now = t;
    const span = Math.max(this.motion.end - this.motion.start, 1e-9);
    for (const part of this.parts) {
      const pose = this.motion.matrix(part.link, t);
      this.times.forEach((time, i) => {
        if (i === this.focus) return void part.strength.setX(i, 1.8);
        const away = displacement(pose, part.poses[i], part.radius);
        const apart = Math.min(Math.max((away - 0.015) / 0.06, 0), 1);  // hides what the robot itself stands in
        const near = Math.exp(-Math.abs(time - t) / (0.12 * span));
        part.strength.setX(i, part.fresh[i] ? apart * this.share * (0.10 + 0.55 * near) : 0);
      });
      part.strength.needsUpdate = true;
    }
  }

  recolour(colours: Colours): void {
    this.gain = colours.ghost;
    this.material.uniforms.gain.value = colours.ghost;
  }

  // From straight above the ghosts would cover the support polygon.
  xray(on: boolean): void { this.material.uniforms.gain.value = on ? 0.3 * this.gain : this.gain; }
}

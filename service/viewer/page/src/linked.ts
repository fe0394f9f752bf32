// Layers of the robot: meshes that follow their links, in tones that tell extremities and sides.
import { BufferGeometry, Group, Mesh, MeshStandardMaterial, Quaternion, ReplaceStencilOp, Vector3 } from "three";
import { Layer } from "./layer";
import { Motion } from "./motion";
import { Colours } from "./theme";

type Tone = "robot" | "joint" | "left" | "right";
const TONES: Tone[] = ["robot", "joint", "left", "right"];
const EXTREMITY = /hand|foot|finger|hook|gripper|palm|tool|wrist|wr[xy]|ankle|ak[xy]/i;

function toneOf(link: string, order: number): Tone {
  if (EXTREMITY.test(link)) {
    if (/^(l_|left|l[A-Z])|_l_|_left|_l$/.test(link)) return "left";
    if (/^(r_|right|r[A-Z])|_r_|_right|_r$/.test(link)) return "right";
  }
  return order % 2 === 0 ? "robot" : "joint";
}

export interface Link { group: Group; link: number }

// Puts the groups of links where the motion has them at a time.
export function placeLinks(links: Link[], motion: Motion, t: number): void {
  const position = new Vector3();
  const rotation = new Quaternion();
  for (const { group, link } of links) {
    motion.pose(link, t, position, rotation);
    group.position.copy(position);
    group.quaternion.copy(rotation);
  }
}

export interface Part { name: string; geometry: BufferGeometry }

export abstract class LinkedMeshes implements Layer {
  abstract readonly name: string;
  abstract readonly label: string;
  abstract readonly key: string;
  abstract get count(): number;
  readonly group = new Group();
  readonly meshes: Mesh[] = [];
  private readonly links: Link[] = [];
  private readonly materials = {} as Record<Tone, MeshStandardMaterial>;

  constructor(private readonly motion: Motion, look: { roughness: number; metalness: number; side?: 2 }) {
    for (const tone of TONES) {
      this.materials[tone] = new MeshStandardMaterial({ flatShading: true, ...look });
      // Marks the robot's pixels, so that what lies in front of it is drawn thinner there.
      Object.assign(this.materials[tone], { stencilWrite: true, stencilRef: 1, stencilZPass: ReplaceStencilOp });
    }
  }

  // Adds the parts of every link that has some; `finish` may add more to the group of such a link.
  protected addLinks(partsOf: (link: string) => Part[], finish: (link: string, group: Group) => void = () => {}): void {
    if (this.motion.nFrames === 0) return;
    this.motion.links.forEach((name, link) => {
      const parts = partsOf(name);
      if (parts.length === 0) return;
      const group = new Group();
      const material = this.materials[toneOf(name, this.links.length)];
      for (const part of parts) {
        const mesh = new Mesh(part.geometry, material);
        mesh.name = part.name;
        mesh.castShadow = true;
        mesh.receiveShadow = true;
        this.meshes.push(mesh);
        group.add(mesh);
      }
      finish(name, group);
      this.links.push({ group, link });
      this.group.add(group);
    });
  }

  update(t: number): void { placeLinks(this.links, this.motion, t); }

  recolour(colours: Colours): void {
    for (const tone of TONES) this.materials[tone].color.set(colours[tone]);
  }

  xray(on: boolean): void {
    for (const tone of TONES) {
      Object.assign(this.materials[tone], { transparent: on, opacity: on ? 0.14 : 1, depthWrite: !on });
      this.materials[tone].needsUpdate = true;
    }
  }
}

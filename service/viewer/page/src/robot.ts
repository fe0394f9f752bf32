// The robot: flat-shaded hulls that follow their links.
import {
  Group, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial, Quaternion, ReplaceStencilOp, Vector3,
} from "three";
import { Body } from "./data";
import { edgeGeometry, hullGeometry } from "./geometry";
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

export class Robot implements Layer {
  readonly name = "robot";
  readonly label = "Robot";
  readonly key = "r";
  readonly group = new Group();
  readonly meshes: Mesh[] = [];
  private readonly links: { group: Group; link: number }[] = [];
  private readonly materials = {} as Record<Tone, MeshStandardMaterial>;
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.6, vertexColors: true });

  constructor(bodies: Body[], private readonly motion: Motion) {
    for (const tone of TONES) {
      this.materials[tone] = new MeshStandardMaterial({ flatShading: true, roughness: 0.62, metalness: 0.08 });
      // Marks the robot's pixels, so that what lies in front of it is drawn thinner there.
      Object.assign(this.materials[tone], { stencilWrite: true, stencilRef: 1, stencilZPass: ReplaceStencilOp });
    }
    if (motion.nFrames === 0) return;
    motion.links.forEach((name, link) => {
      const own = bodies.filter((body) => body.link === name);
      if (own.length === 0) return;
      const group = new Group();
      const material = this.materials[toneOf(name, this.links.length)];
      for (const body of own) {
        const mesh = new Mesh(hullGeometry(body.hull), material);
        mesh.name = body.name;
        mesh.castShadow = true;
        mesh.receiveShadow = true;
        this.meshes.push(mesh);
        group.add(mesh);
      }
      group.add(new LineSegments(edgeGeometry(own.map((body) => body.hull)), this.edges));
      this.links.push({ group, link });
      this.group.add(group);
    });
  }

  get count(): number { return this.meshes.length; }

  update(t: number): void {
    const position = new Vector3();
    const rotation = new Quaternion();
    for (const { group, link } of this.links) {
      this.motion.pose(link, t, position, rotation);
      group.position.copy(position);
      group.quaternion.copy(rotation);
    }
  }

  recolour(colours: Colours): void {
    for (const tone of TONES) this.materials[tone].color.set(colours[tone]);
    this.edges.color.set(colours.edge);
  }

  xray(on: boolean): void {
    for (const tone of TONES) {
      Object.assign(this.materials[tone], { transparent: on, opacity: on ? 0.14 : 1, depthWrite: !on });
      this.materials[tone].needsUpdate = true;
    }
  }
}

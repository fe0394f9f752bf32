// What the robot looks like: the meshes of its description, simplified; nothing is checked against them.
import { BufferAttribute, BufferGeometry, DoubleSide } from "three";
import { Visual } from "./data";
import { LinkedMeshes } from "./linked";
import { Motion } from "./motion";

export class Visuals extends LinkedMeshes {
  readonly name = "visuals";
  readonly label = "Robot as it looks";
  readonly key = "l";

  constructor(visuals: Visual[], motion: Motion) {
    super(motion, { roughness: 0.55, metalness: 0.1, side: DoubleSide });
    this.addLinks((link) => visuals.filter((visual) => visual.link === link).map(({ vertices, triangles }) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(vertices, 3));
      geometry.setIndex(new BufferAttribute(triangles, 1));
      return { name: link, geometry };
    }));
  }

  get count(): number { return this.group.children.length; }
}

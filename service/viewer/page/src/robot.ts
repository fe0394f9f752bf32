// The robot: flat-shaded hulls that follow their links.
import { LineBasicMaterial, LineSegments } from "three";
import { Body } from "./data";
import { edgeGeometry, hullGeometry } from "./geometry";
import { LinkedMeshes } from "./linked";
import { Motion } from "./motion";
import { Colours } from "./theme";

export class Robot extends LinkedMeshes {
  readonly name = "robot";
  readonly label: string;
  readonly key = "r";
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.6, vertexColors: true });

  // With a look of its own, the robot's hulls are a layer that is switched on.
  constructor(bodies: Body[], motion: Motion, hasLook: boolean) {
    super(motion, { roughness: 0.62, metalness: 0.08 });
    this.label = hasLook ? "Collision hulls" : "Robot";
    this.group.visible = !hasLook;
    const on = (link: string) => bodies.filter((body) => body.link === link);
    this.addLinks(
      (link) => on(link).map((body) => ({ name: body.name, geometry: hullGeometry(body.hull) })),
      (link, group) => group.add(new LineSegments(edgeGeometry(on(link).map((body) => body.hull)), this.edges)),
    );
  }

  get count(): number { return this.meshes.length; }

  recolour(colours: Colours): void {
    super.recolour(colours);
    this.edges.color.set(colours.edge);
  }
}

// The robot and what it moves as physics carried them out: translucent, beside the plan.
import { Group, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial } from "three";
import { Body, Result, Simulated } from "./data";
import { edgeGeometry, hullGeometry } from "./geometry";
import { Layer, Legend } from "./layer";
import { Link, placeLinks } from "./linked";
import { Motion } from "./motion";
import { Colours } from "./theme";

const OPACITY = 0.42;

export class SimulatedRobot implements Layer {
  readonly name = "simulated";
  readonly label = "Robot in physics";
  readonly key = "y";
  readonly group = new Group();
  readonly count: number;
  private readonly motion: Motion;
  private readonly links: Link[] = [];
  private readonly material = new MeshStandardMaterial({
    flatShading: true, roughness: 0.7, transparent: true, opacity: OPACITY, depthWrite: false,
  });
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.5 });

  constructor(result: Result, bodies: Body[], private readonly simulated: Simulated) {
    this.motion = new Motion({ ...result, ...simulated });
    this.count = bodies.length;
    result.links.forEach((name, link) => {
      const own = bodies.filter((body) => body.link === name);
      if (own.length === 0) return;
      const group = new Group();
      for (const body of own) group.add(new Mesh(hullGeometry(body.hull), this.material));
      group.add(new LineSegments(edgeGeometry(own.map((body) => body.hull)), this.edges));
      this.links.push({ group, link });
      this.group.add(group);
    });
  }

  update(t: number): void { placeLinks(this.links, this.motion, t); }

  recolour(colours: Colours): void {
    this.material.color.set(colours.simulated);
    this.edges.color.set(colours.simulated);
  }

  legend(): Legend | undefined {
    return this.group.visible ? { colour: `#${this.material.color.getHexString()}`, text: `in physics: ${this.simulated.verdict}` } : undefined;
  }
}

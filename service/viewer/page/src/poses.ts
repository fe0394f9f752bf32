// The poses of one phase in the scene: all of them as light ghosts, the chosen or selected one as a solid robot.
import {
  BufferGeometry, Color, Group, InstancedBufferAttribute, InstancedMesh, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial,
  NotEqualStencilFunc, ReplaceStencilOp, ShaderMaterial,
} from "three";
import { Body } from "./data";
import { edgeGeometry, hullGeometry, smoothHullGeometry } from "./geometry";
import { FRAGMENT, VERTEX } from "./ghosts";
import { Layer, Legend } from "./layer";
import { PoseGraph, chosenIn, poseOfLink } from "./pose-data";
import { Colours } from "./theme";

const SOLID_BIT = 2;  // of the stencil; the robot itself uses 1

interface Ghost { mesh: InstancedMesh; link: number }

export class Poses implements Layer {
  readonly name = "poses";
  readonly label = "Poses of a phase";
  readonly key = "q";
  readonly group = new Group();
  readonly count: number;
  phase = -1;
  selected = -1;
  onChange: () => void = () => {};
  private readonly ghosts: Ghost[] = [];
  private readonly links: { group: Group; link: number }[] = [];
  private readonly tint: InstancedBufferAttribute;
  private readonly strength: InstancedBufferAttribute;
  private readonly glass = new ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: { gain: { value: 1 } }, transparent: true, depthWrite: false,
    stencilWrite: true, stencilRef: SOLID_BIT, stencilFuncMask: SOLID_BIT, stencilWriteMask: 0, stencilFunc: NotEqualStencilFunc,
  });
  // The ghosts leave out its pixels: a cloud of them would hide it.
  private readonly solid = new MeshStandardMaterial({
    flatShading: true, roughness: 0.6, metalness: 0.05, stencilWrite: true, stencilRef: SOLID_BIT, stencilWriteMask: SOLID_BIT,
    stencilZPass: ReplaceStencilOp,
  });
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.6, vertexColors: true });
  private readonly colour = new Color();

  // initial: the phase whose poses are shown where none was chosen.
  constructor(private readonly graph: PoseGraph, bodies: Body[], private readonly initial: () => number) {
    this.count = graph.poses.filter((pose) => pose.drawn >= 0).length;
    this.group.visible = false;
    const most = Math.max(1, ...graph.phases.map((_, phase) => this.drawnIn(phase).length));
    this.tint = new InstancedBufferAttribute(new Float32Array(3 * most), 3);
    this.strength = new InstancedBufferAttribute(new Float32Array(most).fill(1), 1);
    graph.links.forEach((name, link) => {
      const own = bodies.filter((body) => body.link === name);
      if (own.length === 0) return;
      for (const body of own) this.ghosts.push({ mesh: this.makeGhosts(smoothHullGeometry(body.hull), most), link });
      const group = new Group();
      for (const body of own) {
        const mesh = new Mesh(hullGeometry(body.hull), this.solid);
        mesh.castShadow = true;
        group.add(mesh);
      }
      group.add(new LineSegments(edgeGeometry(own.map((body) => body.hull)), this.edges));
      group.matrixAutoUpdate = false;
      this.links.push({ group, link });
      this.group.add(group);
    });
  }

  private makeGhosts(geometry: BufferGeometry, most: number): InstancedMesh {
    geometry.setAttribute("tint", this.tint);
    geometry.setAttribute("strength", this.strength);
    const mesh = new InstancedMesh(geometry, this.glass, most);
    mesh.frustumCulled = false;
    mesh.renderOrder = -1;  // before the glass of the robot, which replaces the stencil
    mesh.count = 0;
    this.group.add(mesh);
    return mesh;
  }

  private drawnIn(phase: number): number[] {
    return this.graph.poses.flatMap((pose, i) => (pose.phase === phase && pose.drawn >= 0 ? [i] : []));
  }

  // The pose that is drawn strongly: the selected one, else the one on the chosen path.
  get strong(): number {
    const pose = this.selected >= 0 ? this.selected : chosenIn(this.graph, this.phase);
    return (this.graph.poses[pose]?.drawn ?? -1) >= 0 ? pose : -1;
  }

  // Show the poses of a phase (none: -1) and one of them strongly; -1 is the chosen one.
  show(phase: number, selected = -1): void {
    this.phase = phase;
    this.selected = selected;
    const { strong } = this;
    const light = this.drawnIn(phase).filter((pose) => pose !== strong);
    // Many ghosts overlap: together they stay as light as a few.
    const share = Math.min(0.6, Math.max(14 / Math.max(light.length, 1), 0.03));
    this.strength.array.fill(share);
    this.strength.needsUpdate = true;
    for (const { mesh, link } of this.ghosts) {
      mesh.count = light.length;
      light.forEach((pose, i) => mesh.setMatrixAt(i, poseOfLink(this.graph, this.graph.poses[pose], link)));
      mesh.instanceMatrix.needsUpdate = true;
    }
    for (const { group, link } of this.links) {
      group.visible = strong >= 0;
      if (strong < 0) continue;
      group.matrix.copy(poseOfLink(this.graph, this.graph.poses[strong], link));
      group.matrixWorldNeedsUpdate = true;
    }
    this.onChange();
  }

  // Switched on without a phase, it shows that of the motion's time.
  update(): void {
    if (this.group.visible && this.phase < 0) this.show(this.initial());
  }

  legend(): Legend | undefined {
    const phase = this.graph.phases[this.phase];
    if (!this.group.visible || !phase) return undefined;
    const { strong } = this;
    const which = strong < 0 ? "" : this.graph.path.includes(strong) ? "; solid: the chosen one" : `; solid: place ${this.graph.poses[strong].place}`;
    return { colour: `#${this.colour.getHexString()}`, text: `${this.drawnIn(this.phase).length} poses of '${phase.name}'${which}` };
  }

  recolour(colours: Colours): void {
    this.colour.set(colours.pose);
    this.solid.color.copy(this.colour);
    this.edges.color.set(colours.edge);
    this.glass.uniforms.gain.value = colours.ghost;
    for (let i = 0; i < this.tint.count; i++) this.colour.toArray(this.tint.array, 3 * i);
    this.tint.needsUpdate = true;
  }

  xray(on: boolean): void {
    Object.assign(this.solid, { transparent: on, opacity: on ? 0.3 : 1, depthWrite: !on });
    this.solid.needsUpdate = true;
  }
}

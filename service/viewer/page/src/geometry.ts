// Shapes that the layers share: hulls, crisp edges, ribbons on the floor, tubes in space.
import { BufferAttribute, BufferGeometry, CatmullRomCurve3, Float32BufferAttribute, TubeGeometry, Vector2, Vector3 } from "three";
import { Hull } from "./packed";
import { timeColour } from "./theme";

export function hullGeometry(hull: Hull): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(hull.vertices, 3));
  geometry.setIndex(new BufferAttribute(hull.triangles, 1));
  const flat = geometry.toNonIndexed();
  flat.computeVertexNormals();
  flat.computeBoundingSphere();
  return flat;
}

// The same with normals that run smoothly round the body, for shading that should show outlines only.
export function smoothHullGeometry(hull: Hull): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(hull.vertices, 3));
  geometry.setIndex(new BufferAttribute(hull.triangles, 1));
  geometry.computeVertexNormals();
  geometry.computeBoundingSphere();
  return geometry;
}

// Feature edges as line segments, each the more visible the sharper it bends: boxes are crisp, round things stay calm.
export function edgeGeometry(hulls: Hull[]): BufferGeometry {
  const positions: number[] = [];
  const colours: number[] = [];
  for (const hull of hulls) {
    hull.edges.forEach((index, i) => {
      positions.push(...hull.vertices.subarray(3 * index, 3 * index + 3));
      const degrees = (hull.bends[i >> 1] * 180) / 255;
      const strength = Math.min(Math.max((degrees - 6) / 54, 0.06), 1);
      colours.push(1, 1, 1, strength);
    });
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(positions, 3));
  geometry.setAttribute("color", new Float32BufferAttribute(colours, 4));
  return geometry;
}

// A flat band of given width along a polyline in the xy plane, mitred at its corners.
export function ribbon(path: Vector2[], z: number, width: number, closed: boolean, colours: boolean): BufferGeometry {
  const line = path.filter((p, i) => i === 0 || p.distanceTo(path[i - 1]) > 1e-5);
  if (closed && line.length > 1 && line[0].distanceTo(line[line.length - 1]) < 1e-5) line.pop();
  const n = line.length;
  const positions: number[] = [];
  const tints: number[] = [];
  const faces: number[] = [];
  for (let i = 0; i < n; i++) {
    const before = closed ? line[(i + n - 1) % n] : line[Math.max(i - 1, 0)];
    const after = closed ? line[(i + 1) % n] : line[Math.min(i + 1, n - 1)];
    const into = line[i].clone().sub(before);
    const out = after.clone().sub(line[i]);
    if (into.length() < 1e-9) into.copy(out);
    if (out.length() < 1e-9) out.copy(into);
    into.normalize();
    out.normalize();
    const normal = new Vector2(-into.y - out.y, into.x + out.x);
    if (normal.length() < 1e-3) normal.set(-into.y, into.x);
    normal.normalize();
    const mitre = Math.min(2, 1 / Math.max(0.3, normal.dot(new Vector2(-out.y, out.x))));
    normal.multiplyScalar((mitre * width) / 2);
    positions.push(line[i].x + normal.x, line[i].y + normal.y, z, line[i].x - normal.x, line[i].y - normal.y, z);
    const tint = timeColour(n > 1 ? i / (n - 1) : 0);
    tints.push(tint.r, tint.g, tint.b, tint.r, tint.g, tint.b);
    const next = closed ? (i + 1) % n : i + 1;
    if (next < n) faces.push(2 * i, 2 * i + 1, 2 * next, 2 * i + 1, 2 * next + 1, 2 * next);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(positions, 3));
  if (colours) geometry.setAttribute("color", new Float32BufferAttribute(tints, 3));
  geometry.setIndex(faces);
  return geometry;
}

export function filledPolygon(corners: number[][], z: number): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(corners.flatMap(([x, y]) => [x, y, z]), 3));
  geometry.setIndex(corners.slice(2).flatMap((_, i) => [0, i + 1, i + 2]));
  return geometry;
}

// A tube through points, coloured by time; undefined when they all coincide.
export function tube(path: Vector3[], radius: number): BufferGeometry | undefined {
  const line = path.filter((p, i) => i === 0 || p.distanceTo(path[i - 1]) > 1e-4);
  if (line.length < 2) return undefined;
  const sides = 6;
  const segments = Math.min(4 * line.length, 400);
  const geometry = new TubeGeometry(new CatmullRomCurve3(line), segments, radius, sides, false);
  const tints = new Float32Array(geometry.getAttribute("position").count * 3);
  for (let i = 0; i <= segments; i++) {
    const tint = timeColour(i / segments);
    for (let j = 0; j <= sides; j++) tint.toArray(tints, 3 * (i * (sides + 1) + j));
  }
  geometry.setAttribute("color", new BufferAttribute(tints, 3));
  return geometry;
}

// The convex polygon whose edges are moved inward by a margin; empty when nothing is left.
export function shrunk(corners: number[][], margin: number): number[][] {
  const area = corners.reduce((sum, [x, y], i) => {
    const [u, v] = corners[(i + 1) % corners.length];
    return sum + x * v - u * y;
  }, 0);
  const ring = area < 0 ? [...corners].reverse() : corners;
  let kept = ring;
  ring.forEach(([x, y], i) => {
    const [u, v] = ring[(i + 1) % ring.length];
    const length = Math.hypot(u - x, v - y);
    if (length < 1e-9) return;
    const nx = -(v - y) / length;
    const ny = (u - x) / length;
    const inside = (p: number[]): number => (p[0] - x) * nx + (p[1] - y) * ny - margin;
    const next: number[][] = [];
    kept.forEach((p, j) => {
      const q = kept[(j + 1) % kept.length];
      const a = inside(p);
      const b = inside(q);
      if (a >= 0) next.push(p);
      if (a * b < 0) next.push([p[0] + ((q[0] - p[0]) * a) / (a - b), p[1] + ((q[1] - p[1]) * a) / (a - b)]);
    });
    kept = next;
  });
  return kept;
}

// How far a point lies inside a convex polygon (negative: outside) [m].
export function insideBy(corners: number[][], x: number, y: number): number {
  let area = 0;
  let least = Infinity;
  corners.forEach(([a, b], i) => {
    const [c, d] = corners[(i + 1) % corners.length];
    area += a * d - c * b;
    const length = Math.hypot(c - a, d - b);
    if (length > 1e-9) least = Math.min(least, (-(d - b) * (x - a) + (c - a) * (y - b)) / length);
  });
  if (area >= 0) return least;
  return insideBy([...corners].reverse(), x, y);
}

// The corners of the convex hull in the plane, counter-clockwise; corners keep their height.
export function convexRing(corners: number[][]): number[][] {
  const sorted = [...corners].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const turns = (a: number[], b: number[], c: number[]): number => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  const half = (points: number[][]): number[][] => {
    const chain: number[][] = [];
    for (const p of points) {
      while (chain.length > 1 && turns(chain[chain.length - 2], chain[chain.length - 1], p) <= 0) chain.pop();
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

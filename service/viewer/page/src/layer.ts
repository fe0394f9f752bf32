// What every part of the scene offers to the page.
import { Group } from "three";
import { Colours } from "./theme";

// What a layer's colour means, and its scale, while it shows something.
export interface Legend { colour: string; text: string }

export interface Layer {
  readonly name: string;   // as in the URL's layers=...
  readonly label: string;  // as in the panel
  readonly key: string;    // keyboard toggle
  readonly group: Group;
  readonly count: number;  // how many things it shows
  update?(t: number): void;
  recolour(colours: Colours): void;
  xray?(on: boolean): void;
  legend?(): Legend | Legend[] | undefined;
}

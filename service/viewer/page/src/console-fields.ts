// Fields of forms, and the choices that the browser remembers.
import { el } from "./dom";

const LATEST = "scopt-console-";

export const recall = (name: string): string | null => localStorage.getItem(LATEST + name);
export const remember = (name: string, value: string): void => localStorage.setItem(LATEST + name, value);

export function choice(name: string, values: [string, string][], chosen: string, act: (value: string) => void): HTMLSelectElement {
  const select = el("select", "choice", ...values.map(([value, text]) => {
    const option = el("option", "", text);
    option.value = value;
    return option;
  }));
  select.setAttribute("aria-label", name);
  select.value = chosen;
  select.addEventListener("change", () => act(select.value));
  return select;
}

export const labelled = (name: string, ...content: HTMLElement[]): HTMLElement => el("label", "field", el("span", "", name), ...content);

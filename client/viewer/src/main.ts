import { element } from "./dom";
import { Page } from "./page";

declare global {
  interface Window {
    incise: Page;
  }
}

/** Why this browser cannot draw the body; empty: it can. */
function troubleWithWebGl(): string {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context ? "" : "This browser offers no WebGL 2, which the page needs to draw the body.";
}

function giveUp(why: string): void {
  element("no-picture-why").textContent = why;
  element("no-picture").hidden = false;
  element("connection").dataset.stage = "ended";
  element("connection-text").textContent = "No picture";
  document.body.dataset.picture = "none";
}

const trouble = troubleWithWebGl();
if (trouble) {
  giveUp(trouble);
} else {
  try {
    window.incise = new Page();
  } catch (error) {
    console.error(error);
    giveUp(`The page could not start (${error instanceof Error ? error.message : error}).`);
  }
}

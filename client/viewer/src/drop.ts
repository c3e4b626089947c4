import { save } from "./dom";
import { notice } from "./notices";

// What incised reads (server/mesh_io/FORMATS.md), and what belongs to it.
const kSurfaces = ["stl", "ply", "off", "obj"];
const kVolumes = ["vtu", "vtk", "msh", "mesh", "node", "ele", "veg"];
const kOthers = ["mtl", "png", "jpg", "jpeg", "webp"]; // materials and images of an .obj

const endingOf = (name: string) => (/\.([^.]+)$/.exec(name)?.[1] ?? "").toLowerCase();

export interface Answer {
  text: string;
  config?: { name: string; content: string }; // that the text speaks of
}

/**
 * What to say of files that were dropped on the page, none of which is a capture that it can play. A page brings no mesh: filling a surface takes
 * TetGen and minutes, and the body belongs to everybody who is connected.
 */
export function answerTo(names: readonly string[], local: boolean): Answer {
  const mesh = names.find((name) => [...kSurfaces, ...kVolumes].includes(endingOf(name)));
  if (mesh !== undefined && local)
    return {
      text: `${mesh} is not opened: this page has no server, and its body is made beforehand. PAGE.md says how, under "Without a server"; or start incised with it.`,
    };
  if (mesh !== undefined) {
    const name = `${mesh.slice(0, -endingOf(mesh).length - 1) || "body"}.json`;
    const content = `${JSON.stringify({ mesh: { path: mesh } }, null, 2)}\n`;
    const filled = kSurfaces.includes(endingOf(mesh)) ? ", which fills it with tetrahedra" : "";
    return {
      text: `${mesh} is not opened here: the body is the server's, for everybody. Save its configuration beside it and run incised --config "${name}"${filled}.`,
      config: { name, content },
    };
  }
  if (names.some((name) => endingOf(name) === "capture"))
    return {
      text: "Recordings are played from the server's folder capture.library: put the file there and reload the page.",
    };
  const one = names[0] ?? "That";
  if (kOthers.includes(endingOf(one)))
    return { text: `${one} belongs to a surface, whose own file goes to incised; it finds this one beside it.` };
  return {
    text: `${one} is not a mesh that incised reads. Those are .${[...kSurfaces, ...kVolumes].join(", .")}.`,
  };
}

/** Takes files that are dropped on the page, so that the browser does not leave it to show them. */
export function acceptDrops(local: boolean, openCapture: (file: File) => void): void {
  addEventListener("dragover", (e) => {
    if (e.dataTransfer?.types.includes("Files")) e.preventDefault();
  });
  addEventListener("drop", (e) => {
    const files = [...(e.dataTransfer?.files ?? [])];
    if (files.length === 0) return;
    e.preventDefault();
    const capture = files.find((file) => endingOf(file.name) === "capture");
    if (local && capture) return openCapture(capture);
    const { text, config } = answerTo(
      files.map((file) => file.name),
      local,
    );
    if (config) notice(text, "Save it", () => save(config.content, config.name));
    else notice(text);
  });
}

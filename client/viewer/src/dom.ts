export const element = <T extends HTMLElement = HTMLElement>(id: string): T => document.getElementById(id) as T;
export const input = (id: string) => element<HTMLInputElement>(id);
export const number = (x: number, digits = 0) =>
  x.toLocaleString("en", { maximumFractionDigits: digits, minimumFractionDigits: digits });

/** Calls back with the value of the radio button chosen in this group. */
export function onChoice(id: string, chosen: (value: string) => void): void {
  element(id).addEventListener("change", (e) => chosen((e.target as HTMLInputElement).value));
}

export function choose(id: string, value: string): void {
  for (const radio of element(id).querySelectorAll<HTMLInputElement>("input[type=radio]"))
    radio.checked = radio.value === value;
}

/** Opens a dialog; `closed` is told whether it was confirmed. */
export function ask(id: string, closed: (confirmed: boolean) => void): void {
  const dialog = element<HTMLDialogElement>(id);
  if (dialog.open) return;
  dialog.onclose = () => closed(dialog.returnValue === "ok");
  dialog.returnValue = "";
  dialog.showModal();
}

/** Gives the user a file. */
export function save(content: BlobPart, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

"use strict";
// A click on a heading sorts its table; a second click reverses the order.
for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const heading = button.parentElement;
    const row = heading.parentElement;
    const place = [...row.children].indexOf(heading);
    const down = heading.getAttribute("aria-sort") === "ascending";
    for (const other of row.children) other.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    const body = row.parentElement.parentElement.tBodies[0];
    const key = (line) => {
      const { dataset, textContent } = line.cells[place];
      if (dataset.value !== undefined) return Number(dataset.value);
      // An interval, "low to high", is sorted by its lower end.
      const ends = /^[−\d.]+(?:e-?\d+)?(?= to )/.exec(textContent);
      return ends === null ? textContent : Number(ends[0].replace("−", "-"));
    };
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (typeof x === "number" && typeof y === "number") return x - y;
      // Cells without a number come last.
      if (typeof x !== typeof y) return (typeof x === "number" ? -1 : 1) * (down ? -1 : 1);
      return x.localeCompare(y, "en", { numeric: true });
    };
    const lines = [...body.rows].sort(compare);
    if (down) lines.reverse();
    body.append(...lines);
  });
}

// The tooltip shows the value nearest to the pointer.
const tip = document.getElementById("tip");
const reach = 26;
const middle = (mark) => {
  const box = mark.getBoundingClientRect();
  return [box.left + box.width / 2, box.top + box.height / 2, box];
};
const point = (svg, event) => {
  let best = null;
  let least = reach;
  for (const mark of svg.querySelectorAll("[data-tip]")) {
    if (mark.classList.contains("off")) continue;
    const [x, y, box] = middle(mark);
    const inside =
      event.clientX >= box.left && event.clientX <= box.right &&
      event.clientY >= box.top && event.clientY <= box.bottom;
    const distance = inside ? 0 : Math.hypot(event.clientX - x, event.clientY - y);
    if (distance < least) [best, least] = [mark, distance];
  }
  if (best === null) {
    tip.hidden = true;
    return;
  }
  tip.textContent = best.dataset.tip;
  tip.hidden = false;
  const width = document.documentElement.clientWidth;
  const left = Math.min(event.clientX + 14, width - tip.offsetWidth - 8);
  tip.style.left = `${Math.max(8, left) + window.scrollX}px`;
  tip.style.top = `${event.clientY + 16 + window.scrollY}px`;
};
for (const svg of document.querySelectorAll("figure svg")) {
  // The browser's own tooltip would cover ours.
  svg.querySelector("title")?.remove();
  svg.addEventListener("pointermove", (event) => point(svg, event));
  svg.addEventListener("pointerdown", (event) => point(svg, event));
  // Lifting a finger counts as leaving; the tooltip of a tap stays until the next tap.
  svg.addEventListener("pointerleave", (event) => {
    if (event.pointerType !== "touch") tip.hidden = true;
  });
}
document.addEventListener("pointerdown", (event) => {
  if (!event.target.closest("figure svg")) tip.hidden = true;
});

// An unchecked box hides the marks of its value in all figures of the experiment.
for (const list of document.querySelectorAll(".switches")) {
  const section = list.closest("section");
  const boxes = [...list.querySelectorAll("[data-toggle]")];
  list.addEventListener("change", () => {
    const hidden = boxes.filter((box) => !box.checked).map((box) => box.dataset.toggle);
    for (const mark of section.querySelectorAll("figure svg [data-series]")) {
      mark.classList.toggle("off", hidden.some((value) => mark.classList.contains(value)));
    }
  });
}

// A table that is too wide for the page shows a hint above it. The arrow of a sorted column widens the table.
const hint = (scroll) => {
  const more = scroll.scrollWidth > scroll.clientWidth + 1;
  scroll.previousElementSibling.hidden = !more;
};
const sizes = new ResizeObserver((entries) => entries.forEach((entry) => hint(entry.target.closest(".scroll"))));
for (const sized of document.querySelectorAll(".scroll, .scroll table")) sizes.observe(sized);

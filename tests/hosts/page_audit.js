// What is wrong with a page: names, ids, headings, roles, sizes of what is touched, contrasts, width.
() => {
  const found = [], say = (element, what) => found.push(`${element.outerHTML.slice(0, 120)}: ${what}`);
  const seen = (element) => element.checkVisibility({ visibilityProperty: true });
  const text = (ids) => (ids || "").split(" ").map((id) => document.getElementById(id)?.textContent || "").join(" ").trim();
  const own = (element) => (["BUTTON", "A"].includes(element.tagName) ? element.textContent.trim() : "");
  const named = "button, a, img, section, table, dialog, [role=img], [role=progressbar]";
  for (const element of document.querySelectorAll(named)) {
    const name = text(element.getAttribute("aria-labelledby")) || element.getAttribute("aria-label") || element.alt;
    if (seen(element) && !name && !own(element)) say(element, "it has no name");
  }
  const ids = [...document.querySelectorAll("[id]")].map((element) => element.id);
  if (new Set(ids).size < ids.length) found.push("an id stands twice");
  const levels = [...document.querySelectorAll("h1, h2, h3")].filter(seen).map((element) => +element.tagName[1]);
  if (levels[0] !== 1 || levels.some((level, k) => level > (levels[k - 1] || 0) + 1)) found.push(`headings ${levels}`);
  for (const element of document.querySelectorAll("h1, h2, button, a")) if (element.hasAttribute("role")) say(element, "it has another role");
  for (const element of document.querySelectorAll("svg:not([role])")) if (!element.ariaHidden) say(element, "it is neither named nor hidden");
  for (const element of document.querySelectorAll("button, a")) {
    const box = element.getBoundingClientRect(), least = element.tagName === "A" ? 24 : 44;
    if (seen(element) && Math.min(box.width, box.height) < least) say(element, `${box.width} by ${box.height} is small to touch`);
  }
  const parsed = (color) => (color.match(/[\d.]+/g) || [0, 0, 0, 0]).map(Number);
  const linear = (part) => (part /= 255) <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const behind = (element) => {
    for (; element; element = element.parentElement) {
      const color = parsed(getComputedStyle(element).backgroundColor);
      if (color.length < 4 || color[3] === 1) return color;
    }
    return [255, 255, 255];
  };
  const opacity = (element) => (element ? +getComputedStyle(element).opacity * opacity(element.parentElement) : 1);
  const judge = (element, color, least) => {
    const back = behind(element), share = opacity(element) * (color[3] ?? 1);
    const [high, low] = [luminance(color.slice(0, 3).map((part, k) => share * part + (1 - share) * back[k])), luminance(back)].sort((a, b) => b - a);
    const ratio = (high + 0.05) / (low + 0.05);
    if (ratio < least) say(element, `contrast ${ratio.toFixed(2)}, expected ${least}`);
  };
  let texts = 0;
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const element = walk.currentNode.parentElement, style = getComputedStyle(element);
    if (!walk.currentNode.data.trim() || !seen(element) || element.closest(":disabled, noscript, dialog:not([open])")) continue;
    texts += 1;
    judge(element, parsed(element.namespaceURI.endsWith("svg") ? style.fill : style.color), 4.5);
  }
  if (texts < 5) found.push(`only ${texts} texts were judged`);
  for (const element of document.querySelectorAll("header svg path, #curve polyline, #checks-plot line, #checks-plot circle, rect.found")) {
    if (seen(element) && !document.body.classList.contains("stale")) judge(element, parsed(getComputedStyle(element).stroke === "none" ? getComputedStyle(element).fill : getComputedStyle(element).stroke), 3);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push(`it is ${document.documentElement.scrollWidth} pixels wide`);
  return found;
}
